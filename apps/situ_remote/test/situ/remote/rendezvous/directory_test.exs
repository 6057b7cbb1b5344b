defmodule Situ.Remote.Rendezvous.DirectoryTest do
  use ExUnit.Case, async: true
  alias Situ.Remote.Rendezvous.Directory
  doctest Directory

  test "another's name is left alone, one's own may change" do
    one = %{name: "a", version: "1", endpoints: []}
    two = %{one | endpoints: [{:clock, "h", 1, []}]}
    {[{:add, ^one}], directory} = Directory.apply(Directory.new(), :x, {:add, one})
    assert {[], ^directory} = Directory.apply(directory, :x, {:add, one})
    assert {[], ^directory} = Directory.apply(directory, :y, {:add, two})

    assert {[{:remove, "a"}, {:add, ^two}], directory} =
             Directory.apply(directory, :x, {:add, two})

    assert Directory.processes(directory) == [two]
    assert {[], ^directory} = Directory.gone(directory, :y)
  end
end

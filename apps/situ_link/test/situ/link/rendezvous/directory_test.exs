defmodule Situ.Link.Rendezvous.DirectoryTest do
  use ExUnit.Case, async: true
  alias Situ.Link.Rendezvous.Directory
  doctest Directory

  test "keeps another client's name, and a client may change its own" do
    one = %{name: "a", version: "1", endpoints: []}
    two = %{one | endpoints: [{:clock, "h", 1, []}]}
    {[{:add, ^one}], directory} = Directory.apply_update(Directory.new(), :x, {:add, one})
    assert {[], ^directory} = Directory.apply_update(directory, :x, {:add, one})
    assert {[], ^directory} = Directory.apply_update(directory, :y, {:add, two})

    assert {[{:remove, "a"}, {:add, ^two}], directory} =
             Directory.apply_update(directory, :x, {:add, two})

    assert Directory.list_processes(directory) == [two]
    assert {[], ^directory} = Directory.remove_owner(directory, :y)
  end

  test "limits the names of one client and the memory of all clients" do
    add = fn directory, owner, name, streams ->
      endpoints = [
        {:address, "a", for(i <- 1..streams//1, do: {String.duplicate("x", 4_000 + i), "t"})}
      ]

      process = %{name: name, version: "1", endpoints: endpoints}
      Directory.apply_update(directory, owner, {:add, process})
    end

    directory = Enum.reduce(1..150, Directory.new(), &elem(add.(&2, :x, "x#{&1}", 0), 1))
    assert length(Directory.list_processes(directory)) == 100
    assert {[_], directory} = add.(directory, :y, "y", 0)
    assert MapSet.equal?(Directory.list_owners(directory), MapSet.new([:x, :y]))
    {_, directory} = Directory.remove_owner(directory, :x)
    full = Enum.reduce(1..100, directory, &elem(add.(&2, {:z, &1}, "z#{&1}", 100), 1))
    assert length(Directory.list_processes(full)) < 100
    assert {[], ^full} = add.(full, :last, "last", 100)
    emptied = Enum.reduce(1..100, full, &elem(Directory.remove_owner(&2, {:z, &1}), 1))
    assert emptied == directory
  end
end

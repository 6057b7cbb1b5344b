defmodule Situ.InspectTest do
  use ExUnit.Case, async: true

  test "streams and pipelines are short in the shell" do
    p = Situ.Pipeline.new()
    numbers = Situ.from_enumerable(p, [1], every: 1, name: "Numbers", type: :integer)
    assert inspect(numbers) == ~s(#Situ.Stream<"Numbers", :integer>)
    assert inspect(p) =~ ~r/^#Situ.Pipeline<#PID<[\d.]+>>$/
    {:ok, inside} = {:ok, Situ.composite(p, "Group", &inspect/1)}
    assert inside =~ ~s(, in "Group">)
    assert {:ok, _} = Situ.Pipeline.stop(p)
  end
end

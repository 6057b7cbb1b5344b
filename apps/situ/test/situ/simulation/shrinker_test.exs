defmodule Situ.Simulation.ShrinkerTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Simulation.Shrinker

  property "it keeps exactly what a failure needs", numtests: 200 do
    forall {all, picked} <- {list(integer(1, 200)), list(integer(0, 20))} do
      deviations = Map.new(all, &{&1, rem(&1, 3) + 1})
      keys = deviations |> Map.keys() |> Enum.sort()
      needed = for i <- Enum.uniq(picked), key = Enum.at(keys, i), do: key
      fails? = fn tried -> Enum.all?(needed, &is_map_key(tried, &1)) end

      assert Shrinker.shrink_deviations(deviations, 10_000, fails?) ==
               Map.take(deviations, needed)
    end
  end

  test "it stops after the allowed number of runs" do
    counter = :counters.new(1, [])

    fails? = fn _tried ->
      :counters.add(counter, 1, 1)
      false
    end

    deviations = Map.new(1..100, &{&1, 1})
    assert Shrinker.shrink_deviations(deviations, 20, fails?) == deviations
    assert :counters.get(counter, 1) == 20
  end
end

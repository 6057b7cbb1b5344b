defmodule Situ.Metric.PropertyTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Rect
  alias Situ.Metric.{Assignment, IntervalScore, Measure, TrackScore, WordScore}

  defp intervals do
    list({integer(0, 100), integer(1, 20)})
    |> map(&Enum.map(&1, fn {from, length} -> {from, from + length} end))
  end

  defp words, do: list(one_of(["a", "b", "c"]))

  # All ways to pair rows with different columns; slow, but obviously right.
  defp all_pairings([], _columns), do: [[]]

  defp all_pairings([row | rest], columns) do
    skipped = all_pairings(rest, columns)

    taken =
      for c <- columns, others <- all_pairings(rest, columns -- [c]), do: [{row, c} | others]

    skipped ++ taken
  end

  property "an assignment pairs as many rows as possible, at the least cost" do
    forall costs <- list(list(one_of([:never, integer(0, 20)]), 4), 3) do
      cost = fn {i, j} -> costs |> Enum.at(i) |> Enum.at(j) end

      allowed =
        Enum.filter(all_pairings([0, 1, 2], [0, 1, 2, 3]), fn p ->
          Enum.all?(p, &(cost.(&1) != :never))
        end)

      best = Enum.min_by(allowed, &{-length(&1), &1 |> Enum.map(cost) |> Enum.sum()})
      pairs = Assignment.pair_rows(costs)
      total = fn list -> list |> Enum.map(cost) |> Enum.sum() end
      assert {length(pairs), total.(pairs)} == {length(best), total.(best)}
    end
  end

  property "matching is one to one, and perfect for equal intervals" do
    forall {truth, output} <- {intervals(), intervals()} do
      pairs = IntervalScore.match_intervals(truth, output, tolerance: 3)
      assert length(pairs) <= min(length(truth), length(output))
      assert length(IntervalScore.match_intervals(truth, truth, tolerance: 0)) == length(truth)
    end
  end

  property "scores are between 0 and 1, and do not depend on the direction of time" do
    forall {truth, output} <- {intervals(), intervals()} do
      score = fn a, b ->
        IntervalScore.compute_values(
          IntervalScore.count_matches(%{"" => a}, %{"" => b}, tolerance: 3)
        )
      end

      turn = &for({a, b} <- &1, do: {-b, -a})
      values = score.(truth, output)
      turned = score.(turn.(truth), turn.(output))

      for name <- ~w(f1 precision recall time_f1),
          do: assert(values[name] in [nil] or (values[name] >= 0 and values[name] <= 1))

      for name <- ~w(f1 time_f1 time_precision), do: assert(values[name] == turned[name])
    end
  end

  property "differences of intervals have the length that the scores count" do
    forall {truth, output} <- {intervals(), intervals()} do
      counts = IntervalScore.count_matches(%{"" => truth}, %{"" => output}, tolerance: 0)

      sum = fn kind ->
        for(
          {^kind, _, a, b} <- IntervalScore.list_differences(%{"" => truth}, %{"" => output}, 0),
          do: b - a
        )
        |> Enum.sum()
      end

      assert sum.("missed") == counts["truth_ns"] - counts["overlap_ns"]
      assert sum.("false") == counts["output_ns"] - counts["overlap_ns"]
    end
  end

  property "the word error rate counts at least the difference in length, and is symmetric" do
    forall {a, b} <- {words(), words()} do
      errors = fn x, y ->
        WordScore.count_errors(Enum.join(x, " "), Enum.join(y, " "))["errors"]
      end

      assert errors.(a, b) == errors.(b, a)
      assert errors.(a, b) >= abs(length(a) - length(b))
      assert errors.(a, b) <= max(length(a), length(b))
      assert errors.(a, a) == 0
    end
  end

  property "merging does not depend on how sessions are grouped" do
    forall parts <- nonempty_list({intervals(), intervals()}) do
      counts =
        for {a, b} <- parts, do: IntervalScore.count_matches(%{"" => a}, %{"" => b}, tolerance: 2)

      {left, right} = Enum.split(counts, div(length(counts), 2))

      groups =
        for group <- [left, right], group != [], do: Measure.merge_all(IntervalScore, group)

      assert Measure.merge_all(IntervalScore, groups) == Measure.merge_all(IntervalScore, counts)
    end
  end

  property "perfect tracks have no errors" do
    forall points <- list({integer(0, 50), integer(0, 50)}) do
      images =
        for {x, y} <- points, do: {%{1 => Rect.new!(x, y, 9, 9)}, %{7 => Rect.new!(x, y, 9, 9)}}

      counts = TrackScore.count_images(images, 0.5)

      assert Map.take(counts, ~w(missed false switches)) == %{
               "missed" => 0,
               "false" => 0,
               "switches" => 0
             }

      assert counts["identity"] == length(points)
    end
  end
end

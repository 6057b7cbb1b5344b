defmodule Situ.Studio.StatisticsTest do
  use ExUnit.Case, async: true

  alias Situ.Studio.{Asking, Statistics}

  defp rows(rows) do
    for row <-
          Statistics.compute_rows(
            Asking.source("S", rows),
            %{stream: "S", path: ""},
            0,
            1_000_000_000_000
          ),
        do: {row, Map.new(row.values, &List.to_tuple/1)}
  end

  test "counts every message, however many there are" do
    n = 250_000
    [{row, stats}] = rows(for i <- 0..(n - 1), do: {i * 1_000, rem(i, 2) == 0})

    assert row.all
    assert %{"n" => ^n, "period_ns" => 1_000, "longest_pause_ns" => 1_000, "mean" => 0.5} = stats
    assert_in_delta stats["rate_hz"], 1.0e6, 1.0e-6
    assert Enum.sum(row.histogram.counts) == n
  end

  test "computes mean and deviation of numbers of any size" do
    [{row, huge}] = rows(for i <- 0..3, do: {i, Enum.at([-9.0e307, 9.0e307, 0.0, 1.0], i)})
    assert_in_delta huge["mean"] / 1.0e307, 0.0, 1.0e-9
    assert_in_delta huge["sd"] / 1.0e307, 7.348469228349534, 1.0e-9
    assert Enum.sum(row.histogram.counts) == 4

    [{_, late}] = rows(for i <- 0..9, do: {i, 1_767_225_600_000_000_000 + i})
    assert_in_delta late["sd"], 3.0276503540974917, 1.0e-12

    [{_, big}] = rows([{0, Integer.pow(10, 200)}, {1, -Integer.pow(10, 200)}])
    assert big["mean"] == 0.0
  end

  test "returns a row for each key of maps, over the messages that have it" do
    assert [{%{name: "S  a"}, a}, {%{name: "S  b"}, b}] =
             rows([
               {0, %{"a" => 1}},
               {10, %{"a" => 3, "b" => 7.0, "c" => "text"}},
               {30, %{"a" => 5}}
             ])

    assert %{"n" => 3, "mean" => 3.0, "longest_pause_ns" => 20} = a
    assert %{"n" => 1, "mean" => 7.0, "sd" => 0.0} = b
  end

  test "measures between both ends by the values that the cursor shows there" do
    measure = fn rows, from, to ->
      [row | _] =
        Statistics.compute_rows(Asking.source("S", rows), %{stream: "S", path: ""}, from, to)

      Map.take(Map.new(row.values, &List.to_tuple/1), [
        "at_start",
        "at_end",
        "change",
        "slope_per_s"
      ])
    end

    s = 1_000_000_000
    rows = for i <- 0..10, do: {i * s, i * i}

    assert measure.(rows, 2 * s + 5, 6 * s + 5) ==
             %{"at_start" => 4, "at_end" => 36, "change" => 32, "slope_per_s" => 8.0}

    assert %{"at_end" => -1, "change" => -3} =
             measure.([{0, %{"b" => 2}}, {s, %{"b" => -1}}], 0, s)

    assert measure.(rows, 5, 5) == %{}
    assert measure.([{5, 1}, {6, 2}], 0, 9) == %{}
    assert Map.keys(measure.([{0, -1.7e308}, {s, 1.7e308}], 0, s)) == ["at_end", "at_start"]
  end

  test "reports an invalid path" do
    assert [%{error: "" <> _, values: []}] =
             Statistics.compute_rows(Asking.source("S", []), %{stream: "S", path: "["}, 0, 1)
  end
end

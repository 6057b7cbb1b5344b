defmodule Situ.Statistics.SlidingTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Statistics
  alias Situ.Statistics.Sliding

  doctest Sliding

  defp value,
    do:
      frequency([{6, integer()}, {4, float(-1.0e3, 1.0e3)}, {1, nil}, {1, :nan}, {1, :infinity}])

  # Computes the statistics of the last n values at each position with the slow reference.
  defp expected(kind, values, n) do
    for i <- n..length(values)//1, do: Statistics.of_list(kind, Enum.slice(values, i - n, n))
  end

  defp sliding(kind, values, n) do
    {results, _window} =
      Enum.map_reduce(values, Sliding.new(kind), fn value, window ->
        window = if Sliding.size(window) == n, do: Sliding.pop(window), else: window
        window = Sliding.push(window, 0, value)
        {if(Sliding.size(window) == n, do: {:some, Sliding.current_result(window)}), window}
      end)

    for {:some, result} <- results, do: result
  end

  defp near?(a, b) when is_number(a) and is_number(b),
    do: abs(a - b) <= 1.0e-9 * max(1.0, abs(b))

  defp near?(a, b), do: a == b

  for kind <- [:count, :sum, :min, :max, :average] do
    property "#{kind} of a sliding window equals that of the list" do
      forall {values, n} <- {list(value()), integer(1, 9)} do
        got = sliding(unquote(kind), values, n)
        wanted = expected(unquote(kind), values, n)
        assert length(got) == length(wanted)
        for {a, b} <- Enum.zip(got, wanted), do: assert(near?(a, b), inspect({a, b}))
      end
    end
  end

  property "the deviation of a sliding window of finite numbers equals that of the list" do
    forall {values, n} <- {list(one_of([integer(), float(-1.0e3, 1.0e3), nil])), integer(1, 9)} do
      for {a, b} <- Enum.zip(sliding(:std, values, n), expected(:std, values, n)),
          do: assert(abs(a - b) <= 1.0e-6 * max(1.0, b), inspect({a, b}))
    end
  end

  test "results do not drift, and NaN is forgotten when it leaves the window" do
    values = [1.0e16, :nan, 1.0] ++ List.duplicate(0.1, 10)
    assert List.last(sliding(:sum, values, 2)) == 0.2
    assert List.last(sliding(:std, values, 4)) == 0.0
  end

  test "the cost of a value does not depend on the window's size" do
    work = fn n ->
      values = Enum.to_list(1..20_000)
      {:reductions, before} = Process.info(self(), :reductions)
      sliding(:average, values, n)
      {:reductions, later} = Process.info(self(), :reductions)
      later - before
    end

    assert work.(10_000) < 3 * work.(10)
  end
end

defmodule Situ.Lifecycle.ClosingTest do
  use ExUnit.Case, async: true

  alias Situ.Lifecycle.Closing

  # Closes stages as the rule says, unsubscribing everything they fed immediately, and returns the ids of each step.
  defp steps(order, edges) do
    active = for {from, to} <- edges, do: %{from: from, output: :out, to: to}
    close(order, active, [])
  end

  defp close(order, active, steps) do
    case Closing.next_to_close(order, active) do
      :done -> Enum.reverse(steps)
      {_rule, ids} -> close(order -- ids, Enum.reject(active, &(&1.from in ids)), [ids | steps])
    end
  end

  test "closes upstream stages first" do
    assert steps([3, 2, 1], [{1, 2}, {2, 3}]) == [[1], [2], [3]]
    assert steps([3, 2, 1], [{1, 3}, {2, 3}]) == [[2, 1], [3]]
  end

  test "one stage on a cycle opens it for the others, which close in stream order" do
    # The cycle is 1 -> 2 -> 3 -> 1, built from last to first.
    assert steps([3, 2, 1], [{1, 2}, {2, 3}, {3, 1}]) == [[3], [1], [2]]
  end

  test "separate cycles are opened in one step, in construction order" do
    assert steps([4, 3, 2, 1], [{1, 3}, {2, 4}, {3, 1}, {4, 2}]) == [[4, 3], [2, 1]]
  end

  test "a stage that feeds only itself closes before its downstream stages" do
    assert steps([4, 3, 2, 1], [{1, 1}, {1, 2}, {3, 3}, {3, 4}]) == [[3, 1], [4, 2]]
  end

  test "without a safe order, closes the stage with the most consumed outputs" do
    active =
      for {from, output, to} <- [{1, :a, 2}, {2, :a, 1}, {2, :b, 3}, {3, :a, 2}],
          do: %{from: from, output: output, to: to}

    assert Closing.next_to_close([3, 1, 2], active) == {:break, [2]}
  end

  test "waits for closing marks in flight" do
    assert Closing.next_to_close([2], [%{from: 1, output: :out, to: 2}]) == :wait
  end
end

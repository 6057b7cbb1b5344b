defmodule Situ.Lifecycle.ClosingTest do
  use ExUnit.Case, async: true

  alias Situ.Lifecycle.Closing

  # Closes what the rule says, with everything it fed unsubscribed at once, until all is closed: the ids, step by step.
  defp steps(order, edges) do
    active = for {from, to} <- edges, do: %{from: from, output: :out, to: to}
    close(order, active, [])
  end

  defp close(order, active, steps) do
    case Closing.next(order, active) do
      :done -> Enum.reverse(steps)
      {_rule, ids} -> close(order -- ids, Enum.reject(active, &(&1.from in ids)), [ids | steps])
    end
  end

  test "upstream first" do
    assert steps([3, 2, 1], [{1, 2}, {2, 3}]) == [[1], [2], [3]]
    assert steps([3, 2, 1], [{1, 3}, {2, 3}]) == [[2, 1], [3]]
  end

  test "one on a cycle opens it for the others, which close in the order of the stream" do
    # 1 to 2 to 3 to 1, built last to first.
    assert steps([3, 2, 1], [{1, 2}, {2, 3}, {3, 1}]) == [[3], [1], [2]]
  end

  test "cycles apart from one another are opened in one step, in order of construction" do
    assert steps([4, 3, 2, 1], [{1, 3}, {2, 4}, {3, 1}, {4, 2}]) == [[4, 3], [2, 1]]
  end

  test "what feeds itself alone goes before what lies behind it" do
    assert steps([4, 3, 2, 1], [{1, 1}, {1, 2}, {3, 3}, {3, 4}]) == [[3, 1], [4, 2]]
  end

  test "no safe order: the one with most listened-to outputs" do
    active =
      for {from, output, to} <- [{1, :a, 2}, {2, :a, 1}, {2, :b, 3}, {3, :a, 2}],
          do: %{from: from, output: output, to: to}

    assert Closing.next([3, 1, 2], active) == {:break, [2]}
  end

  test "closing marks under way are waited for" do
    assert Closing.next([2], [%{from: 1, output: :out, to: 2}]) == :wait
  end
end

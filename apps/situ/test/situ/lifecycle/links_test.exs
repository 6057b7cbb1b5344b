defmodule Situ.Lifecycle.LinksTest do
  use ExUnit.Case, async: true

  alias Situ.Lifecycle.Links

  # Stages 1 and 2 are sources, the others are not.
  defp whole(edges, finite, ids \\ 1..6) do
    stages =
      for id <- ids, into: %{} do
        {id, %{source?: id in [1, 2]}}
      end

    links = for {from, to} <- edges, do: %{from: from, to: to}
    stages |> Links.whole(links, MapSet.new(finite)) |> Enum.sort()
  end

  test "behind finite sources alone streams are whole" do
    assert whole([{1, 3}, {2, 4}, {3, 5}, {4, 6}], [1]) == [1, 3, 5]
    assert whole([{1, 3}, {2, 3}, {3, 4}, {1, 5}], [1]) == [1, 5, 6]
    assert whole([{1, 3}, {2, 3}, {3, 4}, {1, 5}], [1, 2]) == [1, 2, 3, 4, 5, 6]
    assert whole([], []) == [3, 4, 5, 6]
  end

  test "not on a cycle, nor behind one, and two links from one stage are one stage" do
    assert whole([{1, 3}, {3, 4}, {4, 3}, {4, 5}, {1, 6}, {1, 6}], [1, 2]) == [1, 2, 6]
    assert whole([{1, 3}, {3, 3}, {3, 4}], [1, 2]) == [1, 2, 5, 6]
  end

  test "a long chain takes one step a stage" do
    ids = Enum.to_list(3..20_000)
    edges = Enum.zip([1 | ids], ids)
    assert length(whole(edges, [1], [1 | ids])) == 19_999
  end
end

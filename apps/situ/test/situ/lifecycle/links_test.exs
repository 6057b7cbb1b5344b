defmodule Situ.Lifecycle.LinksTest do
  use ExUnit.Case, async: true

  alias Situ.Lifecycle.Links

  # Stages 1 and 2 are sources; the others are not.
  defp whole(edges, finite, ids \\ 1..6) do
    stages =
      for id <- ids, into: %{} do
        {id, %{source?: id in [1, 2]}}
      end

    links = for {from, to} <- edges, do: %{from: from, to: to}
    stages |> Links.complete_stages(links, MapSet.new(finite)) |> Enum.sort()
  end

  test "streams fed only by finite sources are complete" do
    assert whole([{1, 3}, {2, 4}, {3, 5}, {4, 6}], [1]) == [1, 3, 5]
    assert whole([{1, 3}, {2, 3}, {3, 4}, {1, 5}], [1]) == [1, 5, 6]
    assert whole([{1, 3}, {2, 3}, {3, 4}, {1, 5}], [1, 2]) == [1, 2, 3, 4, 5, 6]
    assert whole([], []) == [3, 4, 5, 6]
  end

  test "streams on or after a cycle are not complete, and two links from one stage count once" do
    assert whole([{1, 3}, {3, 4}, {4, 3}, {4, 5}, {1, 6}, {1, 6}], [1, 2]) == [1, 2, 6]
    assert whole([{1, 3}, {3, 3}, {3, 4}], [1, 2]) == [1, 2, 5, 6]
  end

  test "a long chain takes one step per stage" do
    ids = Enum.to_list(3..20_000)
    edges = Enum.zip([1 | ids], ids)
    assert length(whole(edges, [1], [1 | ids])) == 19_999
  end
end

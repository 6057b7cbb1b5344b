defmodule Situ.Live.DiffTest do
  use ExUnit.Case, async: true
  alias Situ.Live.{Comprehension, Diff, Html, Island, Rendered}
  alias Situ.Live.Test.DiffTree

  # A random tree is a list of decisions; equal templates have equal fingerprints.
  defp rendered(depth) do
    :proper_types.oneof(
      for shape <- 0..2 do
        let(values(depth, shape), fn dynamic ->
          static = for i <- 0..shape, do: "<#{shape}.#{i}>"
          %Rendered{static: static, dynamic: dynamic, fingerprint: shape, root?: true}
        end)
      end
    )
  end

  defp values(depth, n), do: :proper_types.vector(n, value(depth))

  defp value(0), do: :proper_types.elements(["", "a", "b"])

  defp value(depth) do
    :proper_types.frequency([
      {3, value(0)},
      {2, :proper_types.lazy(fn -> rendered(depth - 1) end)},
      {2, :proper_types.lazy(fn -> list(depth - 1) end)},
      {1, :proper_types.lazy(fn -> island(depth - 1) end)}
    ])
  end

  defp list(depth) do
    entry =
      :proper_types.tuple([
        :proper_types.oneof([nil, :proper_types.integer(1, 6)]),
        values(depth, 2)
      ])

    let(:proper_types.list(entry), fn entries ->
      %Comprehension{static: ["[", "|", "]"], entries: entries, fingerprint: 77}
    end)
  end

  defp island(depth), do: let(rendered(depth), fn rendered -> %Island{rendered: rendered} end)

  defp let(type, fun), do: :proper_types.bind(type, fun, false)

  test "merging the diffs of any sequence of trees gives the last one" do
    property =
      :proper.forall(:proper_types.non_empty(:proper_types.list(rendered(2))), fn trees ->
        Enum.reduce(trees, {%{}, %Diff{}}, fn tree, {shown, memory} ->
          {diff, memory} = Diff.diff_tree(tree, memory)
          shown = DiffTree.merge_diff(shown, diff)
          true = DiffTree.to_html(shown) == Html.to_html(tree)
          {again, ^memory} = Diff.diff_tree(tree, memory)
          true = again == %{}
          {shown, memory}
        end)

        true
      end)

    assert :proper.quickcheck(property, [:quiet, numtests: 300, max_size: 16]) == true
  end

  test "sends only the position of a moved entry, and nothing for an unmoved one" do
    list = fn keys ->
      entries = for k <- keys, do: {k, ["v#{k}"]}
      list = %Comprehension{static: ["", ""], entries: entries, fingerprint: 1}
      %Rendered{static: ["", ""], dynamic: [list], fingerprint: 2}
    end

    {_, memory} = Diff.diff_tree(list.([1, 2, 3]))
    {diff, memory} = Diff.diff_tree(list.([3, 1]), memory)
    assert diff == %{"0" => %{"k" => %{"0" => 2, "1" => 0, "kc" => 2, "km" => true}}}
    {diff, _} = Diff.diff_tree(list.([3, 1, 4]), memory)
    assert diff == %{"0" => %{"k" => %{"2" => %{"0" => "v4"}, "kc" => 3}}}
  end

  test "an unchanged part that was never sent is stale" do
    tree = %Rendered{static: ["", ""], dynamic: [:unchanged], fingerprint: 1}
    assert Diff.diff_tree(tree) == :stale
  end
end

defmodule Situ.IndexerTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Indexer

  doctest Indexer

  # A slow reference: an array of this shape as nested lists of its flat indices.
  defp array(shape),
    do: nest(Enum.to_list(0..(Enum.product(shape) - 1)), tl(shape) |> Enum.reverse())

  defp nest(flat, []), do: flat
  defp nest(flat, [size | sizes]), do: flat |> Enum.chunk_every(size) |> nest(sizes)

  defp pick(list, []), do: list

  defp pick(list, [slice | slices]),
    do: for(i <- chosen(length(list), slice), do: list |> Enum.at(i) |> pick(slices))

  defp chosen(n, :all), do: Enum.to_list(0..(n - 1))
  defp chosen(_n, at) when is_integer(at), do: [at]
  defp chosen(_n, {:take, list}), do: list
  defp chosen(_n, {a, b}), do: Enum.to_list(a..b)
  defp chosen(_n, {a, b, step}) when a <= b, do: Enum.to_list(a..b//step)
  defp chosen(_n, {a, b, step}), do: Enum.to_list(a..b//-step)

  defp slice do
    one_of([
      :all,
      integer(0, 1),
      {integer(0, 2), integer(0, 2)},
      {integer(0, 2), integer(0, 2), integer(1, 2)},
      {:take, nonempty_list(integer(0, 2))}
    ])
  end

  property "a view has the same elements as nested lists, in the same order" do
    forall {shape, slices} <- {list(integer(3, 4), 3), list(slice(), 3)} do
      assert Indexer.flat_indices(shape, slices) ==
               shape |> array() |> pick(slices) |> List.flatten()

      view = shape |> Indexer.new() |> Indexer.slice(slices)
      assert Enum.product(Indexer.shape(view)) == length(Indexer.flat_indices(view))
    end
  end

  property "ranges contain the same indices in the same order" do
    forall {shape, slices} <- {list(integer(3, 4), 2), list(slice(), 2)} do
      runs = Indexer.index_ranges(shape, slices)

      assert Enum.flat_map(runs, fn {a, b} -> Enum.to_list(a..b) end) ==
               Indexer.flat_indices(shape, slices)
    end
  end

  property "a slice of a slice counts within the first slice" do
    forall {a, b} <- {slice(), integer(0, 0)} do
      view = Indexer.new([5]) |> Indexer.slice([a]) |> Indexer.slice([b])
      assert Indexer.flat_indices(view) == [hd(Indexer.flat_indices([5], [a]))]
    end
  end

  test "refuses indices and slices that do not fit" do
    assert_raise ArgumentError, ~r/outside of 0..4/, fn -> Indexer.flat_indices([5], [5]) end

    assert_raise ArgumentError, ~r/2 slices for 1/, fn ->
      Indexer.flat_indices([5], [:all, :all])
    end

    assert_raise ArgumentError, ~r/not a slice/, fn -> Indexer.flat_indices([5], [:some]) end
  end
end

defmodule Situ.Indexer do
  @moduledoc """
  Which elements of an n-dimensional array, stored in row-major order, a slice names.

  A dimension's range is `{first, last}`, both included; it may decrease.

      iex> Situ.Indexer.indices([10, 10], [{0, 1}, :all]) |> Enum.count()
      20
      iex> Situ.Indexer.ranges([10, 10, 10], [{0, 1}, :all, :all])
      [{0, 199}]
  """

  @type range :: {first :: integer(), last :: integer()}
  @type slice :: :all | integer() | range()

  @doc "How many values the range has."
  @spec size(range()) :: pos_integer()
  def size({first, last}), do: abs(last - first) + 1

  @doc "Whether it does not decrease."
  @spec increasing?(range()) :: boolean()
  def increasing?({first, last}), do: last >= first

  @doc "Whether it has one value."
  @spec single_valued?(range()) :: boolean()
  def single_valued?({first, last}), do: first == last

  @doc """
  The values of a range, or those of a slice of it (counted from its first value).

      iex> Situ.Indexer.values({5, 10}, {1, 3})
      [6, 7, 8]
  """
  @spec values(range(), slice()) :: [integer()]
  def values(range, slice \\ :all)
  def values({first, last}, :all), do: Enum.to_list(first..last)
  def values(range, at) when is_integer(at), do: values(range, {at, at})

  def values(range, {from, to}) do
    values = values(range)
    size = length(values)

    if min(from, to) < 0 or max(from, to) >= size do
      raise ArgumentError, "slice #{from}..#{to} is outside of 0..#{size - 1}"
    end

    Enum.map(from..to, &Enum.at(values, &1))
  end

  @doc "The flat indices of the slice, one slice per dimension (default: everything)."
  @spec indices([pos_integer()], [slice()] | nil) :: [non_neg_integer()]
  def indices(shape, slices \\ nil) do
    slices = slices || Enum.map(shape, fn _ -> :all end)

    if length(slices) != length(shape) do
      raise ArgumentError, "#{length(slices)} slices for #{length(shape)} dimensions"
    end

    shape
    |> Enum.zip(slices)
    |> Enum.reduce([0], fn {size, slice}, prefixes ->
      for prefix <- prefixes, value <- values({0, size - 1}, slice), do: prefix * size + value
    end)
  end

  @doc "The flat indices as runs of neighbours, each `{first, last}`."
  @spec ranges([pos_integer()], [slice()] | nil) :: [range()]
  def ranges(shape, slices \\ nil), do: shape |> indices(slices) |> runs()

  @doc """
  A list of indices as runs of neighbours.

      iex> Situ.Indexer.runs([1, 2, 3, 7, 8])
      [{1, 3}, {7, 8}]
  """
  @spec runs([integer()]) :: [range()]
  def runs(indices) do
    indices
    |> Enum.reduce([], fn
      index, [{first, last} | rest] when index == last + 1 -> [{first, index} | rest]
      index, runs -> [{index, index} | runs]
    end)
    |> Enum.reverse()
  end
end

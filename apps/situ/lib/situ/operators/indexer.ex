defmodule Situ.Indexer do
  @moduledoc """
  Which elements of an n-dimensional array, stored in row-major order, a view of it names: slices, strides, single
  indices, lists of them, and slices of slices. The array itself is wherever you have it; an indexer answers flat
  indices, and runs of neighbours to copy at once.

      iex> Situ.Indexer.indices([10, 10], [{0, 1}, :all]) |> Enum.count()
      20
      iex> Situ.Indexer.ranges([10, 10, 10], [{0, 1}, :all, :all])
      [{0, 199}]

      iex> rows = Situ.Indexer.new([4, 6]) |> Situ.Indexer.slice([{1, 3}, {0, 5, 2}])
      iex> view = Situ.Indexer.slice(rows, [:all, {2, 1}])
      iex> {Situ.Indexer.shape(view), Situ.Indexer.indices(view)}
      {[3, 2], [10, 8, 16, 14, 22, 20]}

  A range is `{first, last}`, both included; it may decrease. Of a dimension a slice is `:all`, an index, a range, a
  range with a step (`{first, last, step}`), or `{:take, indices}`; indices count from the first value of the view
  that is sliced.
  """

  @enforce_keys [:shape, :values]
  defstruct [:shape, :values]

  @typedoc "Of an array of this `shape`: the indices per dimension that the view has, in its order."
  @type t :: %__MODULE__{shape: [pos_integer()], values: [[non_neg_integer()]]}
  @type range :: {first :: integer(), last :: integer()}
  @type slice ::
          :all
          | integer()
          | range()
          | {first :: integer(), last :: integer(), step :: pos_integer()}
          | {:take, [integer()]}

  @doc "The whole of an array of this shape."
  @spec new([pos_integer()]) :: t()
  def new(shape),
    do: %__MODULE__{shape: shape, values: Enum.map(shape, &Enum.to_list(0..(&1 - 1)//1))}

  @doc "A view of a view: one slice per dimension."
  @spec slice(t(), [slice()]) :: t()
  def slice(%__MODULE__{} = view, slices) do
    if length(slices) != length(view.shape) do
      raise ArgumentError, "#{length(slices)} slices for #{length(view.shape)} dimensions"
    end

    %{view | values: Enum.zip_with(view.values, slices, &picked/2)}
  end

  @doc "How many indices of each dimension the view has."
  @spec shape(t()) :: [non_neg_integer()]
  def shape(%__MODULE__{values: values}), do: Enum.map(values, &length/1)

  @doc """
  How far apart neighbours of each dimension lie in an array of this shape.

      iex> Situ.Indexer.strides([4, 6, 2])
      [12, 2, 1]
  """
  @spec strides([pos_integer()]) :: [pos_integer()]
  def strides(shape) do
    {strides, _size} = shape |> Enum.reverse() |> Enum.map_reduce(1, &{&2, &1 * &2})
    Enum.reverse(strides)
  end

  @doc "The flat indices of a view, or of the slices of an array of this shape (default: everything)."
  @spec indices(t() | [pos_integer()], [slice()] | nil) :: [non_neg_integer()]
  def indices(shape_or_view, slices \\ nil)

  def indices(%__MODULE__{shape: shape, values: values}, nil) do
    Enum.zip_reduce(shape, values, [0], fn size, values, prefixes ->
      for prefix <- prefixes, value <- values, do: prefix * size + value
    end)
  end

  def indices(%__MODULE__{} = view, slices), do: view |> slice(slices) |> indices()
  def indices(shape, nil), do: indices(new(shape))
  def indices(shape, slices), do: shape |> new() |> slice(slices) |> indices()

  @doc "The flat indices as runs of neighbours, each `{first, last}`."
  @spec ranges(t() | [pos_integer()], [slice()] | nil) :: [range()]
  def ranges(shape_or_view, slices \\ nil), do: shape_or_view |> indices(slices) |> runs()

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
      iex> Situ.Indexer.values({5, 10}, {:take, [5, 0]})
      [10, 5]
  """
  @spec values(range(), slice()) :: [integer()]
  def values({first, last}, slice \\ :all), do: picked(Enum.to_list(first..last), slice)

  defp picked(values, :all), do: values
  defp picked(values, at) when is_integer(at), do: picked(values, {:take, [at]})
  defp picked(values, {from, to}) when is_integer(from), do: picked(values, {from, to, 1})

  defp picked(values, {from, to, step}) when is_integer(step) and step > 0,
    do: picked(values, {:take, Enum.to_list(from..to//if(to >= from, do: step, else: -step))})

  defp picked(values, {:take, indices}) do
    all = List.to_tuple(values)

    for index <- indices do
      if index < 0 or index >= tuple_size(all) do
        raise ArgumentError, "index #{index} is outside of 0..#{tuple_size(all) - 1}"
      end

      elem(all, index)
    end
  end

  defp picked(_values, other), do: raise(ArgumentError, "not a slice: #{inspect(other)}")
end

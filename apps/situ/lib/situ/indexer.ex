defmodule Situ.Indexer do
  @moduledoc false
  # Computes which elements of an n-dimensional array, stored in row-major order, belong to a view of it. Views select
  # slices, strides, single indices, lists of indices, and slices of slices. The array can be stored anywhere. An
  # indexer returns flat indices, and ranges of adjacent elements that can be copied in one operation.
  #
  # A range is `{first, last}`, both included; it may decrease. A slice of a dimension is `:all`, an index, a range, a
  # range with a step (`{first, last, step}`), or `{:take, indices}`. Indices are relative to the first value of the
  # sliced view.

  @enforce_keys [:shape, :values]
  defstruct [:shape, :values]

  @typedoc "A view of an array of this `shape`: the selected indices per dimension, in the view's order."
  @type t :: %__MODULE__{shape: [pos_integer()], values: [[non_neg_integer()]]}
  @type range :: {first :: integer(), last :: integer()}
  @type slice ::
          :all
          | integer()
          | range()
          | {first :: integer(), last :: integer(), step :: pos_integer()}
          | {:take, [integer()]}

  @doc "Builds a view of a complete array of this shape."
  @spec new([pos_integer()]) :: t()
  def new(shape),
    do: %__MODULE__{shape: shape, values: Enum.map(shape, &Enum.to_list(0..(&1 - 1)//1))}

  @doc """
  Slices a view, with one slice per dimension.

      iex> rows = Situ.Indexer.new([4, 6]) |> Situ.Indexer.slice([{1, 3}, {0, 5, 2}])
      iex> view = Situ.Indexer.slice(rows, [:all, {2, 1}])
      iex> {Situ.Indexer.shape(view), Situ.Indexer.flat_indices(view)}
      {[3, 2], [10, 8, 16, 14, 22, 20]}
  """
  @spec slice(t(), [slice()]) :: t()
  def slice(%__MODULE__{} = view, slices) do
    if length(slices) != length(view.shape) do
      raise ArgumentError, "#{length(slices)} slices for #{length(view.shape)} dimensions"
    end

    %{view | values: Enum.zip_with(view.values, slices, &select_values/2)}
  end

  @doc "Returns the number of selected indices per dimension."
  @spec shape(t()) :: [non_neg_integer()]
  def shape(%__MODULE__{values: values}), do: Enum.map(values, &length/1)

  @doc """
  Returns the distance between neighbours of each dimension in an array of this shape.

      iex> Situ.Indexer.strides([4, 6, 2])
      [12, 2, 1]
  """
  @spec strides([pos_integer()]) :: [pos_integer()]
  def strides(shape) do
    {strides, _size} = shape |> Enum.reverse() |> Enum.map_reduce(1, &{&2, &1 * &2})
    Enum.reverse(strides)
  end

  @doc "Returns the flat indices of a view, or of slices of an array of this shape (default: all)."
  @spec flat_indices(t() | [pos_integer()], [slice()] | nil) :: [non_neg_integer()]
  def flat_indices(shape_or_view, slices \\ nil)

  def flat_indices(%__MODULE__{shape: shape, values: values}, nil) do
    Enum.zip_reduce(shape, values, [0], fn size, values, prefixes ->
      for prefix <- prefixes, value <- values, do: prefix * size + value
    end)
  end

  def flat_indices(%__MODULE__{} = view, slices), do: view |> slice(slices) |> flat_indices()
  def flat_indices(shape, nil), do: flat_indices(new(shape))
  def flat_indices(shape, slices), do: shape |> new() |> slice(slices) |> flat_indices()

  @doc """
  Returns the flat indices as ranges of adjacent elements, each `{first, last}`.

      iex> Situ.Indexer.flat_indices([10, 10], [{0, 1}, :all]) |> Enum.count()
      20
      iex> Situ.Indexer.index_ranges([10, 10, 10], [{0, 1}, :all, :all])
      [{0, 199}]
  """
  @spec index_ranges(t() | [pos_integer()], [slice()] | nil) :: [range()]
  def index_ranges(shape_or_view, slices \\ nil),
    do: shape_or_view |> flat_indices(slices) |> group_runs()

  @doc """
  Groups a list of indices into ranges of adjacent elements.

      iex> Situ.Indexer.group_runs([1, 2, 3, 7, 8])
      [{1, 3}, {7, 8}]
  """
  @spec group_runs([integer()]) :: [range()]
  def group_runs(indices) do
    indices
    |> Enum.reduce([], fn
      index, [{first, last} | rest] when index == last + 1 -> [{first, index} | rest]
      index, runs -> [{index, index} | runs]
    end)
    |> Enum.reverse()
  end

  @doc "Returns the number of values in a range."
  @spec range_size(range()) :: pos_integer()
  def range_size({first, last}), do: abs(last - first) + 1

  @doc "Returns whether a range does not decrease."
  @spec increasing_range?(range()) :: boolean()
  def increasing_range?({first, last}), do: last >= first

  @doc "Returns whether a range has a single value."
  @spec single_valued?(range()) :: boolean()
  def single_valued?({first, last}), do: first == last

  @doc """
  Returns the values of a range, or of a slice of it (relative to its first value).

      iex> Situ.Indexer.range_values({5, 10}, {1, 3})
      [6, 7, 8]
      iex> Situ.Indexer.range_values({5, 10}, {:take, [5, 0]})
      [10, 5]
  """
  @spec range_values(range(), slice()) :: [integer()]
  def range_values({first, last}, slice \\ :all),
    do: select_values(Enum.to_list(first..last), slice)

  defp select_values(values, :all), do: values
  defp select_values(values, at) when is_integer(at), do: select_values(values, {:take, [at]})

  defp select_values(values, {from, to}) when is_integer(from),
    do: select_values(values, {from, to, 1})

  defp select_values(values, {from, to, step}) when is_integer(step) and step > 0,
    do:
      select_values(
        values,
        {:take, Enum.to_list(from..to//if(to >= from, do: step, else: -step))}
      )

  defp select_values(values, {:take, indices}) do
    all = List.to_tuple(values)

    for index <- indices do
      if index < 0 or index >= tuple_size(all) do
        raise ArgumentError, "index #{index} is outside of 0..#{tuple_size(all) - 1}"
      end

      elem(all, index)
    end
  end

  defp select_values(_values, other), do: raise(ArgumentError, "not a slice: #{inspect(other)}")
end

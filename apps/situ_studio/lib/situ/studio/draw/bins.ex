defmodule Situ.Studio.Draw.Bins do
  @moduledoc false
  # Folds points into bins that are aligned to multiples of their width, so that panning yields
  # the same bins again.
  # Bins are aligned, a power of two wide and at most one pixel. Bins with the edges of pixels
  # would have to be fetched again on each pan. The page combines them to opaque columns from
  # minimum to maximum (`assets/js/visualizers/columns.js`): translucent polygons hid single
  # outliers (contrast 1.0 to 1.5), and their edges were off by up to 76 pixels.

  # The largest float, as an integer.
  @greatest trunc(1.797_693_134_862_315_7e308)

  @type point :: Situ.Codec.point()
  @type gap :: {Situ.Time.t(), nil, nil, nil, pos_integer()}

  @doc """
  Builds the point of one value at one time.

      iex> points = for t <- 0..3, do: Situ.Studio.Draw.Bins.point(t, t * 1.0)
      iex> Situ.Studio.Draw.Bins.fold_points(points, 2, 2)
      {[{0, 0.0, 1.0, 1.0, 2}, {2, 2.0, 3.0, 3.0, 2}], false}
  """
  @spec point(Situ.Time.t(), number()) :: point()
  def point(time, value), do: {time, value, value, value, 1}

  @doc "Builds a point that interrupts a line."
  @spec gap(Situ.Time.t()) :: gap()
  def gap(time), do: {time, nil, nil, nil, 1}

  @doc """
  Shifts the times of points, or of other rows that begin with a time, by `offset` ns.

      iex> Situ.Studio.Draw.Bins.shift_points([{5, 1.0, 1.0, 1.0, 1}], 10)
      [{15, 1.0, 1.0, 1.0, 1}]
  """
  @spec shift_points([tuple()], Situ.Time.duration()) :: [tuple()]
  def shift_points(points, 0), do: points
  def shift_points(points, offset), do: for(p <- points, do: put_elem(p, 0, elem(p, 0) + offset))

  @doc "Returns whether a point interrupts its line."
  @spec gap?(point() | gap()) :: boolean()
  def gap?(point), do: elem(point, 1) == nil

  @doc """
  Returns the points of a line for one value: a point for a number, a gap for `nil`, `:nan` and infinities, none for
  other terms.

      iex> Enum.map([1, nil, :nan, "x"], &Situ.Studio.Draw.Bins.value_points(5, &1))
      [[{5, 1, 1, 1, 1}], [{5, nil, nil, nil, 1}], [{5, nil, nil, nil, 1}], []]
  """
  @spec value_points(Situ.Time.t(), term()) :: [point() | gap()]
  def value_points(time, value) when value in [nil, :nan, :infinity, :neg_infinity],
    do: [gap(time)]

  def value_points(time, %Situ.Studio.Gap{}), do: [gap(time)]

  def value_points(time, value) do
    case to_number(value) do
      {:ok, number} -> [point(time, number)]
      :error -> []
    end
  end

  @doc "Returns the points of a line for one message. The data of a codec, such as audio, may have many."
  @spec message_points(Situ.Message.t()) :: [point() | gap()]
  def message_points(%{data: %module{} = data, originating_time: time}) do
    if function_exported?(module, :points, 2),
      do: module.points(data, time),
      else: value_points(time, data)
  end

  def message_points(%{data: data, originating_time: time}), do: value_points(time, data)

  @doc """
  Returns a value as a number to draw: booleans are 0 and 1. Other terms, and integers too large for a float, are
  `:error`.

      iex> Enum.map([1.7e308, true, :nan], &Situ.Studio.Draw.Bins.to_number/1)
      [{:ok, 1.7e308}, {:ok, 1}, :error]
  """
  @spec to_number(term()) :: {:ok, number()} | :error
  def to_number(value) when is_float(value), do: {:ok, value}

  def to_number(value) when is_integer(value) and value <= @greatest and value >= -@greatest,
    do: {:ok, value}

  def to_number(true), do: {:ok, 1}
  def to_number(false), do: {:ok, 0}
  def to_number(_), do: :error

  @doc "Returns up to `keep` points unchanged (`true`), or folds more of them into bins `bin` ns wide (`false`)."
  @spec fold_points([point() | gap()], pos_integer(), pos_integer()) ::
          {[point() | gap()], raw? :: boolean()}
  def fold_points(points, bin, keep) do
    if length(points) <= keep, do: {points, true}, else: {fold_bins(points, bin), false}
  end

  defp fold_bins(points, bin) do
    points
    |> Enum.chunk_by(fn {t, _, _, _, _} -> Integer.floor_div(t, bin) end)
    |> Enum.map(fn [first | rest] -> Enum.reduce(rest, first, &merge_points(&2, &1)) end)
  end

  # A gap is visible only if its bin contains nothing else.
  defp merge_points({t, min, max, last, n}, {_, nil, nil, nil, k}), do: {t, min, max, last, n + k}
  defp merge_points({t, nil, nil, nil, n}, {_, min, max, last, k}), do: {t, min, max, last, n + k}

  defp merge_points({t, min, max, _, n}, {_, lo, hi, last, k}),
    do: {t, min(min, lo), max(max, hi), last, n + k}
end

defmodule Situ.Window.ByColumns do
  @moduledoc false
  # The pure core of windows with `with: :columns`: by index, or of the past, as in ByIndex and Trailing. A window is a
  # slice of the kept columns, so nothing is copied for each window.
  alias Situ.{Columns, Interval}

  @enforce_keys [:span, :fun]
  defstruct [:span, :fun, :kept]

  @typedoc """
  `span` is `{need, anchor, skip, size}`: how many messages a window and its anchor need, and the positions of the
  anchor and the window among them; or `{:past, left, inclusive?}`. `kept` are the columns that later windows need.
  """
  @type t :: %__MODULE__{
          span:
            {pos_integer(), non_neg_integer(), integer(), pos_integer()}
            | {:past, integer(), boolean()},
          fun: (Columns.t() -> term()),
          kept: Columns.t() | nil
        }

  @doc "Builds a window. `fun` takes its columns."
  @spec new(Range.t() | Interval.t(), (Columns.t() -> term())) :: t()
  def new(%Range{first: from, last: to}, fun) do
    {from, to} = {min(from, to), max(from, to)}
    start = min(from, 0)
    span = {max(to, 0) - start + 1, -start, from - start, to - from + 1}
    %__MODULE__{span: span, fun: fun}
  end

  def new(%Interval{right: 0, right_inclusive: true, left: left} = past, fun),
    do: %__MODULE__{span: {:past, left, past.left_inclusive}, fun: fun}

  @doc """
  Adds columns and returns the windows they complete.

      iex> window = Situ.Window.ByColumns.new(-1..0, &Enum.sum(Situ.Columns.values(&1)))
      iex> {outputs, _window} = Situ.Window.ByColumns.push(window, Situ.Columns.new([10, 20, 30], [1, 2, 3]))
      iex> outputs
      [{:out, [20, 30], [3, 5]}]
  """
  @spec push(t(), Columns.t()) :: {[Situ.Component.action()], t()}
  def push(%__MODULE__{span: span, kept: kept} = window, columns) do
    all = if kept == nil, do: columns, else: Columns.append(kept, columns)
    {windows, keep} = slide_window(span, all, columns.count)
    {build_outputs(windows, window.fun), %{window | kept: keep_last(all, keep)}}
  end

  # Returns the windows as `{time, columns}`, and how many of the last messages later windows need.
  defp slide_window({need, anchor, skip, size}, %{count: count} = all, _added) do
    windows =
      for i <- 0..(count - need)//1,
          do: {Columns.time_at(all, i + anchor), Columns.slice(all, i + skip, size)}

    {windows, min(need - 1, count)}
  end

  defp slide_window({:past, left, inclusive?}, %{count: count} = all, added) do
    windows =
      for i <- (count - added)..(count - 1) do
        time = Columns.time_at(all, i)
        from = count_before(all, time + left, inclusive?)
        {time, Columns.slice(all, from, i + 1 - from)}
      end

    last = Columns.last_time(all)
    {windows, count - count_before(all, last + left, inclusive?)}
  end

  defp count_before(all, time, true), do: Columns.count_until(all, time - 1)
  defp count_before(all, time, false), do: Columns.count_until(all, time)

  defp keep_last(_all, 0), do: nil
  defp keep_last(%{count: count} = all, n), do: Columns.slice(all, count - n, n)

  defp build_outputs([], _fun), do: []

  defp build_outputs(windows, fun) do
    {times, results} =
      windows |> Enum.map(fn {time, part} -> {time, fun.(part)} end) |> Enum.unzip()

    [{:out, times, results}]
  end
end

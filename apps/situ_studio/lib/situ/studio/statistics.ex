defmodule Situ.Studio.Statistics do
  @moduledoc """
  Numbers about the messages of a stream within an interval: how many, how often, how evenly, and of numbers their
  distribution.

      iex> pairs = [{0, 1}, {10, 2}, {20, 3}, {40, 10}]
      iex> messages = for {t, v} <- pairs, do: %Situ.Message{data: v, originating_time: t}
      iex> stats = Map.new(Situ.Studio.Statistics.of(messages, []))
      iex> {stats["n"], stats["mean"], stats["min"], stats["median"], stats["max"]}
      {4, 4.0, 1, 2, 10}
      iex> {stats["rate_hz"], stats["period_ns"], stats["longest_pause_ns"]}
      {7.5e7, 10, 20}

  A gap is a pause of more than three times the usual one. The standard deviation is that of a sample (n - 1);
  percentiles are messages' own values (nearest rank).
  """
  alias Situ.Studio.Draw.{Bins, Messages}
  alias Situ.Studio.{Path, Source}

  # So many times the usual pause without a message is a gap.
  @gap 3

  @doc """
  The statistics of what `vis` draws (`%{stream: name, path: text}`) from `from` to `to`, ready for the page: the
  `name`, the `values` as `[name, number]`, `all` whether every message is in them; of a stream that cannot be read,
  the `error`.
  """
  @spec within(
          Source.t(),
          %{:stream => String.t(), :path => String.t(), optional(atom()) => term()},
          from,
          to
        ) ::
          map()
        when from: Situ.Time.t(), to: Situ.Time.t()
  def within(source, vis, from, to) do
    with {:ok, path} <- Path.parse(vis.path),
         {:ok, messages, all?} <- Messages.within(source, vis.stream, from, to) do
      values = for {name, value} <- of(messages, path), do: [name, value]

      %{
        name: vis.stream <> vis.path,
        all: all?,
        values: values,
        histogram: messages |> numbers(path) |> histogram()
      }
    else
      {:error, error} -> %{name: vis.stream, error: error.what, values: []}
    end
  end

  @doc "Names and values, in the order in which they are shown; `path` picks a part of the messages."
  @spec of([Situ.Message.t()], Path.t()) :: [{String.t(), number()}]
  def of(messages, path) do
    times = Enum.map(messages, & &1.originating_time)

    [{"n", length(messages)}] ++ pace(times) ++ spread(numbers(messages, path))
  end

  defp numbers(messages, path) do
    for m <- messages,
        {:ok, value} <- [Path.fetch(m.data, path)],
        {:ok, number} <- [Bins.number(value)],
        do: number
  end

  @doc """
  How often numbers fall into each of so many equal steps from the least to the greatest; `nil` where they are all
  one.

      iex> Situ.Studio.Statistics.histogram([0, 1, 1, 4], 4)
      %{from: 0, to: 4, counts: [1, 2, 0, 1]}
      iex> Situ.Studio.Statistics.histogram([1, 1])
      nil
  """
  @spec histogram([number()], pos_integer()) ::
          %{from: number(), to: number(), counts: [non_neg_integer()]} | nil
  def histogram(values, steps \\ 40)
  def histogram([], _steps), do: nil

  def histogram(values, steps) do
    {least, greatest} = Enum.min_max(values)

    if greatest > least do
      width = (greatest - least) / steps
      counts = Enum.frequencies_by(values, &min(trunc((&1 - least) / width), steps - 1))
      %{from: least, to: greatest, counts: for(i <- 0..(steps - 1), do: Map.get(counts, i, 0))}
    end
  end

  defp pace([first, _ | _] = times) do
    pauses = times |> Enum.chunk_every(2, 1, :discard) |> Enum.map(fn [a, b] -> b - a end)
    sorted = Enum.sort(pauses)
    span = List.last(times) - first

    [
      {"rate_hz", length(pauses) * 1.0e9 / max(span, 1)},
      {"period_ns", rank(sorted, 0.5)},
      {"jitter_ns", deviation(pauses)},
      {"longest_pause_ns", List.last(sorted)},
      {"gaps", Enum.count(pauses, &(&1 > @gap * rank(sorted, 0.5)))}
    ]
  end

  defp pace(_), do: []

  defp spread([]), do: []

  defp spread(values) do
    sorted = Enum.sort(values)

    [
      {"mean", Enum.sum(values) / length(values)},
      {"sd", deviation(values)},
      {"min", hd(sorted)},
      {"p1", rank(sorted, 0.01)},
      {"p5", rank(sorted, 0.05)},
      {"p25", rank(sorted, 0.25)},
      {"median", rank(sorted, 0.5)},
      {"p75", rank(sorted, 0.75)},
      {"p95", rank(sorted, 0.95)},
      {"p99", rank(sorted, 0.99)},
      {"max", List.last(sorted)}
    ]
  end

  defp rank(sorted, part), do: Enum.at(sorted, max(ceil(part * length(sorted)) - 1, 0))

  defp deviation([_]), do: 0.0

  defp deviation(values) do
    mean = Enum.sum(values) / length(values)
    squares = for x <- values, reduce: 0.0, do: (sum -> sum + (x - mean) * (x - mean))
    :math.sqrt(squares / (length(values) - 1))
  end
end

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
  alias Situ.Studio.{Path, Source}
  alias Situ.Studio.Draw.{Bins, Key}

  # So many times the usual pause without a message is a gap.
  @gap 3
  # Messages are read in pages; beyond the most of them nothing is told but where that is.
  @page 20_000
  @most 2_000_000
  @keys 8
  # Squares of larger numbers are too large for a float.
  @large 1.0e150

  @type row :: %{
          required(:name) => String.t(),
          required(:values) => [[String.t() | number()]],
          optional(:all) => boolean(),
          optional(:error) => String.t(),
          optional(:histogram) => map() | nil
        }

  @doc """
  The statistics of what `vis` draws (`%{stream: name, path: text}`) from `from` to `to`, ready for the page: a row for
  the stream, or for each key (the first eight) of maps of numbers. A row has the `name`, the `values` as `[name,
  number]`, `all`: whether every message is in them (false beyond two million, of which the first are); of a stream
  that cannot be read, the `error`.
  """
  @spec within(
          Source.t(),
          %{:stream => String.t(), :path => String.t(), optional(atom()) => term()},
          Situ.Time.t(),
          Situ.Time.t()
        ) :: [row()]
  def within(source, vis, from, to) do
    with {:ok, path} <- Path.parse(vis.path),
         {:ok, pairs, all?} <- read(source, vis.stream, path, {from, to}) do
      for {name, pairs} <- parts(pairs) do
        numbers = numbers(pairs)

        %{
          name: String.trim_trailing("#{vis.stream}#{vis.path}  #{name}"),
          all: all?,
          values: for({name, value} <- told(pairs, numbers), do: [name, value]),
          histogram: histogram(numbers)
        }
      end
    else
      {:error, error} -> [%{name: vis.stream, error: error.what, values: []}]
    end
  end

  # Of a panel so many streams are told, and so many rows.
  @streams 8
  @rows 16

  @doc """
  Those of all that a panel draws. Millions of messages take a while to read, so this is done by another process, which
  sends `{:statistics, rows}` to the caller.
  """
  @spec begin(Source.t(), [map()], Situ.Time.t(), Situ.Time.t()) :: :ok
  def begin(source, vis, from, to) do
    caller = self()

    {:ok, _} =
      Task.Supervisor.start_child(Situ.Studio.Tasks, fn ->
        rows = vis |> Enum.take(@streams) |> Enum.flat_map(&within(source, &1, from, to))
        send(caller, {:statistics, Enum.take(rows, @rows)})
      end)

    :ok
  end

  # {time, value} of every message; of the value only what is counted, so that pictures are not kept.
  defp read(source, stream, path, range), do: read(source, stream, path, range, [], 0)

  defp read(source, stream, path, {from, to} = range, read, n) do
    case Source.call(source, :messages, [stream, from, to, @page]) do
      {:ok, messages, :more} when messages != [] and n + length(messages) < @most ->
        next = List.last(messages).originating_time + 1
        range = put_elem(range, 0, next)
        read(source, stream, path, range, [slim(messages, path) | read], n + length(messages))

      {:ok, messages, more} ->
        {:ok, Enum.concat(Enum.reverse([slim(messages, path) | read])), more == :all}

      error ->
        error
    end
  end

  defp slim(messages, path) do
    for m <- messages do
      case Path.fetch(m.data, path) do
        {:ok, map} when is_map(map) and not is_struct(map) ->
          {m.originating_time, numbers_of(map)}

        {:ok, value} ->
          {m.originating_time, number(value)}

        :error ->
          {m.originating_time, nil}
      end
    end
  end

  defp numbers_of(map), do: for({k, v} <- map, n = number(v), into: %{}, do: {k, n})

  defp number(value) do
    case Bins.number(value) do
      {:ok, number} -> number
      :error -> nil
    end
  end

  # Maps have a part for each key, with the messages that have it.
  defp parts(pairs) do
    case for({_, %{} = map} <- pairs, key <- Map.keys(map), uniq: true, do: key) do
      [] ->
        [{"", pairs}]

      keys ->
        for key <- keys |> Key.sort() |> Enum.take(@keys),
            do: {Key.text(key), for({t, %{^key => number}} <- pairs, do: {t, number})}
    end
  end

  defp numbers(pairs), do: for({_, number} when is_number(number) <- pairs, do: number)

  @doc "Names and values, in the order in which they are shown; `path` picks a part of the messages."
  @spec of([Situ.Message.t()], Path.t()) :: [{String.t(), number()}]
  def of(messages, path) do
    pairs = slim(messages, path)
    told(pairs, numbers(pairs))
  end

  defp told(pairs, numbers),
    do: [{"n", length(pairs)}] ++ pace(Enum.map(pairs, &elem(&1, 0))) ++ spread(numbers)

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
    # halves, since the difference of two of the largest numbers is none
    width = (greatest / 2 - least / 2) / steps

    if width > 0 do
      step = &min(trunc((&1 / 2 - least / 2) / width), steps - 1)
      counts = Enum.frequencies_by(values, step)
      %{from: least, to: greatest, counts: for(i <- 0..(steps - 1), do: Map.get(counts, i, 0))}
    end
  end

  defp pace([first, _ | _] = times) do
    pauses = times |> Enum.zip(tl(times)) |> Enum.map(fn {a, b} -> b - a end)
    sorted = sorted(pauses)
    usual = rank(sorted, 0.5)
    span = List.last(times) - first

    [
      {"rate_hz", length(pauses) * 1.0e9 / max(span, 1)},
      {"period_ns", usual},
      {"jitter_ns", pauses |> moments() |> elem(1)},
      {"longest_pause_ns", elem(sorted, tuple_size(sorted) - 1)},
      {"gaps", Enum.count(pauses, &(&1 > @gap * usual))}
    ]
  end

  defp pace(_), do: []

  defp spread([]), do: []

  defp spread(values) do
    sorted = sorted(values)
    {mean, sd} = moments(values)

    [
      {"mean", mean},
      {"sd", sd},
      {"min", elem(sorted, 0)},
      {"p1", rank(sorted, 0.01)},
      {"p5", rank(sorted, 0.05)},
      {"p25", rank(sorted, 0.25)},
      {"median", rank(sorted, 0.5)},
      {"p75", rank(sorted, 0.75)},
      {"p95", rank(sorted, 0.95)},
      {"p99", rank(sorted, 0.99)},
      {"max", elem(sorted, tuple_size(sorted) - 1)}
    ]
  end

  defp sorted(values), do: values |> Enum.sort() |> List.to_tuple()

  defp rank(sorted, part), do: elem(sorted, max(ceil(part * tuple_size(sorted)) - 1, 0))

  # Mean and standard deviation, from how far the values are from the first: large ones that differ little keep their
  # digits, and the largest are made smaller before they are squared.
  defp moments([first | _] = values) do
    case Enum.reduce(values, 0.0, &max(abs(&1), &2)) do
      most when most > @large ->
        {mean, sd} = moments(Enum.map(values, &(&1 / most)))
        {mean * most, sd * most}

      _ ->
        n = length(values)
        away = for x <- values, do: x - first
        shift = Enum.sum(away) / n
        squares = for d <- away, reduce: 0.0, do: (sum -> sum + (d - shift) * (d - shift))
        {first + shift, if(n > 1, do: :math.sqrt(squares / (n - 1)), else: 0.0)}
    end
  end
end

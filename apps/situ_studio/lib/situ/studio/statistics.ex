defmodule Situ.Studio.Statistics do
  @moduledoc false
  # Computes statistics of a stream's messages within an interval: count, rate, regularity, the distribution of numeric
  # values, and the values at both ends with their slope.
  #
  # The value at an end is the value of the latest message at or before it, as at the cursor.
  # A gap is a pause of more than three times the median pause. The standard deviation is the
  # sample standard deviation (n - 1); percentiles are values of messages (nearest rank).
  alias Situ.Studio.{ValuePath, StreamReader}
  alias Situ.Studio.Draw.{Bins, Key}

  # A pause longer than this multiple of the median pause is a gap.
  @gap 3
  # Messages are read in pages; messages after the first two million are not included.
  @page 20_000
  @most 2_000_000
  @keys 8
  # The square of a larger number overflows a float.
  @large 1.0e150
  @largest 1.7976931348623157e308

  @type row :: %{
          required(:name) => String.t(),
          required(:values) => [[String.t() | number()]],
          optional(:all) => boolean(),
          optional(:error) => String.t(),
          optional(:histogram) => map() | nil
        }

  @doc """
  Computes the statistics of the stream that `vis` draws (`%{stream: name, path: text}`) from `from` to `to`, in the
  page's format: one row for the stream, or one for each key (the first eight) of maps of numbers. A row contains the
  `name`, the `values` as `[name, number]`, and `all`, whether every message is included (false if there are more than
  two million, of which the first are used). The row of an unreadable stream contains the `error`.
  """
  @spec compute_rows(
          Situ.Recording.t(),
          %{:stream => String.t(), :path => String.t(), optional(atom()) => term()},
          Situ.Time.t(),
          Situ.Time.t()
        ) :: [row()]
  def compute_rows(source, vis, from, to) do
    with {:ok, path} <- ValuePath.parse(vis.path),
         {:ok, pairs, all?} <- read_values(source, vis.stream, path, {from, to}) do
      ends = for time <- [from, to], do: value_at(source, vis.stream, path, time)

      for {name, pairs} <- split_by_key(pairs) do
        numbers = collect_numbers(pairs)
        values = statistic_pairs(pairs, numbers) ++ slope_pairs(ends, name, to - from)

        %{
          name: String.trim_trailing("#{vis.stream}#{vis.path}  #{name}"),
          all: all?,
          values: for({name, value} <- values, do: [name, value]),
          histogram: histogram(numbers)
        }
      end
    else
      {:error, error} -> [%{name: vis.stream, error: error.what, values: []}]
    end
  end

  defp value_at(source, stream, path, time) do
    with {:ok, message} <- StreamReader.latest_at(source, stream, time),
         [{_, value}] <- extract_values([message], path),
         do: value,
         else: (_ -> nil)
  end

  defp slope_pairs(ends, key_name, duration) do
    case Enum.map(ends, &number_of_key(&1, key_name)) do
      [first, last] when is_number(first) and is_number(last) and duration > 0 ->
        [{"at_start", first}, {"at_end", last}] ++ change_pairs(first, last, duration)

      _ ->
        []
    end
  end

  defp number_of_key(%{} = map, name),
    do: Enum.find_value(map, fn {key, number} -> if Key.key_name(key) == name, do: number end)

  defp number_of_key(number, _), do: number

  # The difference of very large numbers is not a float.
  defp change_pairs(first, last, duration) do
    [{"change", last - first}, {"slope_per_s", (last - first) * 1.0e9 / duration}]
  rescue
    ArithmeticError -> []
  end

  # The maximum number of streams and rows for one panel.
  @streams 8
  @rows 16

  @doc """
  Computes the statistics of all streams that a panel draws. Reading millions of messages takes a while, so another
  process does it and sends `{:statistics, rows}` to the caller.
  """
  @spec compute_async(Situ.Recording.t(), [map()], Situ.Time.t(), Situ.Time.t()) :: :ok
  def compute_async(source, vis, from, to) do
    caller = self()

    {:ok, _} =
      Task.Supervisor.start_child(Situ.Studio.Tasks, fn ->
        rows = vis |> Enum.take(@streams) |> Enum.flat_map(&compute_rows(source, &1, from, to))
        send(caller, {:statistics, Enum.take(rows, @rows)})
      end)

    :ok
  end

  # Returns `{time, value}` for every message. Only numbers are kept, so that images do not stay in memory.
  defp read_values(source, stream, path, range),
    do: read_values(source, stream, path, range, [], 0)

  defp read_values(source, stream, path, {from, to} = range, read, n) do
    case StreamReader.read_messages(source, stream, from, to, @page) do
      {:ok, messages, :more} when messages != [] and n + length(messages) < @most ->
        next = List.last(messages).originating_time + 1
        range = put_elem(range, 0, next)

        read_values(
          source,
          stream,
          path,
          range,
          [extract_values(messages, path) | read],
          n + length(messages)
        )

      {:ok, messages, more} ->
        {:ok, Enum.concat(Enum.reverse([extract_values(messages, path) | read])), more == :all}

      error ->
        error
    end
  end

  defp extract_values(messages, path) do
    for m <- messages do
      case ValuePath.fetch(m.data, path) do
        {:ok, map} when is_map(map) and not is_struct(map) ->
          {m.originating_time, map_numbers(map)}

        {:ok, value} ->
          {m.originating_time, to_number(value)}

        :error ->
          {m.originating_time, nil}
      end
    end
  end

  defp map_numbers(map), do: for({k, v} <- map, n = to_number(v), into: %{}, do: {k, n})

  defp to_number(value) do
    case Bins.to_number(value) do
      {:ok, number} -> number
      :error -> nil
    end
  end

  # Splits maps into one part per key, with the messages that contain the key.
  defp split_by_key(pairs) do
    case for({_, %{} = map} <- pairs, key <- Map.keys(map), uniq: true, do: key) do
      [] ->
        [{"", pairs}]

      keys ->
        for key <- keys |> Key.sort_keys() |> Enum.take(@keys),
            do: {Key.key_name(key), for({t, %{^key => number}} <- pairs, do: {t, number})}
    end
  end

  defp collect_numbers(pairs), do: for({_, number} when is_number(number) <- pairs, do: number)

  @doc """
  Returns names and values in display order; `path` selects a part of the messages.

      iex> pairs = [{0, 1}, {10, 2}, {20, 3}, {40, 10}]
      iex> messages = for {t, v} <- pairs, do: %Situ.Message{data: v, originating_time: t}
      iex> stats = Map.new(Situ.Studio.Statistics.compute_statistics(messages, []))
      iex> {stats["n"], stats["mean"], stats["min"], stats["median"], stats["max"]}
      {4, 4.0, 1, 2, 10}
      iex> {stats["rate_hz"], stats["period_ns"], stats["longest_pause_ns"]}
      {7.5e7, 10, 20}
  """
  @spec compute_statistics([Situ.Message.t()], ValuePath.t()) :: [{String.t(), number()}]
  def compute_statistics(messages, path) do
    pairs = extract_values(messages, path)
    statistic_pairs(pairs, collect_numbers(pairs))
  end

  defp statistic_pairs(pairs, numbers),
    do:
      [{"n", length(pairs)}] ++
        timing_statistics(Enum.map(pairs, &elem(&1, 0))) ++ value_statistics(numbers)

  @doc """
  Counts the numbers in equal-width bins from the minimum to the maximum. Returns `nil` if the list is empty or all
  numbers are equal.

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
    # Halving avoids an overflow in the difference of two very large numbers.
    width = (greatest / 2 - least / 2) / steps

    if width > 0 do
      step = &min(trunc((&1 / 2 - least / 2) / width), steps - 1)
      counts = Enum.frequencies_by(values, step)
      %{from: least, to: greatest, counts: for(i <- 0..(steps - 1), do: Map.get(counts, i, 0))}
    end
  end

  defp timing_statistics([first, _ | _] = times) do
    pauses = times |> Enum.zip(tl(times)) |> Enum.map(fn {a, b} -> b - a end)
    sorted = sort_to_tuple(pauses)
    usual = nearest_rank(sorted, 0.5)
    span = List.last(times) - first

    [
      {"rate_hz", length(pauses) * 1.0e9 / max(span, 1)},
      {"period_ns", usual},
      {"jitter_ns", pauses |> mean_and_sd() |> elem(1)},
      {"longest_pause_ns", elem(sorted, tuple_size(sorted) - 1)},
      {"gaps", Enum.count(pauses, &(&1 > @gap * usual))}
    ]
  end

  defp timing_statistics(_), do: []

  defp value_statistics([]), do: []

  defp value_statistics(values) do
    sorted = sort_to_tuple(values)
    {mean, sd} = mean_and_sd(values)

    [
      {"mean", mean},
      {"sd", sd},
      {"min", elem(sorted, 0)},
      {"p1", nearest_rank(sorted, 0.01)},
      {"p5", nearest_rank(sorted, 0.05)},
      {"p25", nearest_rank(sorted, 0.25)},
      {"median", nearest_rank(sorted, 0.5)},
      {"p75", nearest_rank(sorted, 0.75)},
      {"p95", nearest_rank(sorted, 0.95)},
      {"p99", nearest_rank(sorted, 0.99)},
      {"max", elem(sorted, tuple_size(sorted) - 1)}
    ]
  end

  defp sort_to_tuple(values), do: values |> Enum.sort() |> List.to_tuple()

  defp nearest_rank(sorted, part), do: elem(sorted, max(ceil(part * tuple_size(sorted)) - 1, 0))

  # Computes mean and standard deviation from the differences to the first value, which keeps precision for large
  # values with small differences. Very large values are scaled down before they are squared.
  defp mean_and_sd([first | _] = values) do
    case Enum.reduce(values, 0.0, &max(abs(&1), &2)) do
      most when most > @large ->
        {mean, sd} = mean_and_sd(Enum.map(values, &(&1 / most)))
        # The deviation of the largest numbers is larger than any float.
        {mean * most, if(sd > @largest / most, do: @largest, else: sd * most)}

      _ ->
        n = length(values)
        away = for x <- values, do: x - first
        shift = Enum.sum(away) / n
        squares = for d <- away, reduce: 0.0, do: (sum -> sum + (d - shift) * (d - shift))
        {first + shift, if(n > 1, do: :math.sqrt(squares / (n - 1)), else: 0.0)}
    end
  end
end

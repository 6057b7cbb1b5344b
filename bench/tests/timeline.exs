defmodule Situ.Bench.Timeline do
  # The min/max envelope of 2,000 pixels over any span of 10M or 100M stored points, and the
  # states of 10M booleans.
  alias Situ.Store
  alias Situ.Store.{Native, Summary, Writer}

  def tests do
    [
      {"timeline-10m", &timeline("timeline10m", round(10_000_000 * &1))},
      {"timeline-100m", &timeline("timeline100m", round(100_000_000 * &1))},
      {"timeline-booleans-10m", &booleans("timeline_booleans", round(10_000_000 * &1))}
    ]
  end

  # 10 us apart. They are written without a pipeline, which other tests measure.
  @step 10_000

  defp timeline(name, n), do: recorded(name, n, :float, &value/1, &spans/3)

  # Like a button: some spans have a few changes, and most have too many to draw each.
  defp booleans(name, n), do: recorded(name, n, :boolean, &pressed?/1, &states/3)

  defp recorded(name, n, type, value, ask) do
    root = Path.join(System.tmp_dir!(), "situ-bench-#{name}-#{n}-#{System.pid()}")
    File.rm_rf!(root)
    File.mkdir_p!(root)

    try do
      {:ok, writer} = Writer.create("bench", root)
      {:ok, stream} = Writer.stream(writer, "s", type: type)

      recorded =
        Situ.Bench.measure("#{name}_write", n, fn ->
          fill(stream, value, 0, n)
          :ok = Writer.close(writer)
          []
        end)

      recorded ++ ask.(name, Path.join(root, "bench"), n)
    after
      File.rm_rf!(root)
    end
  end

  defp fill(_stream, _value, at, n) when at >= n, do: :ok

  defp fill(stream, value, at, n) do
    messages =
      for i <- at..min(at + 8_191, n - 1) do
        time = i * @step

        %Situ.Message{
          data: value.(i),
          originating_time: time,
          creation_time: time,
          sequence_id: i + 1
        }
      end

    {:ok, stream} = Writer.append(stream, messages)
    fill(stream, value, at + 8_192, n)
  end

  defp value(i), do: rem(i * 7_919, 10_007) * 1.0

  # A change every 1 to 1,000 messages.
  defp pressed?(i), do: rem(div(i * i, 1_000_003), 2) == 1

  defp spans(name, path, n) do
    started = :erlang.monotonic_time(:nanosecond)
    store = Store.open!(path)
    {:ok, info} = Store.stream_info(store, "s")
    opened = :erlang.monotonic_time(:nanosecond) - started
    true = is_integer(Native.summary_level(0, n * @step, 2_000))

    at =
      ask(n, fn from, span ->
        {took, {:ok, width, bins}} =
          timed(fn -> Store.summary(store, info, from, from + span, 2_000) end)

        check(bins, width, from, span, n)
        took
      end)

    [
      {"#{name}_p50", at.(0.5), "ms"},
      {"#{name}_p99", at.(0.99), "ms"},
      {"#{name}_open", opened / 1.0e6, "ms"}
    ]
  end

  defp states(name, path, n) do
    {first, {:ok, _}} = timed(fn -> Summary.read(Store.open!(path), "s", 0, n * @step, 2_000) end)

    store = Store.open!(path)

    at =
      ask(n, fn from, span ->
        {took, {:ok, %{width: width, counts: counts, tracks: [{nil, track}]}}} =
          timed(fn -> Summary.read(store, "s", from, from + span, 2_000) end)

        counted(counts, width, from, span, n)
        told(track, from, n)
        took
      end)

    [
      {"#{name}_first", first, "ms"},
      {"#{name}_p50", at.(0.5), "ms"},
      {"#{name}_p99", at.(0.99), "ms"},
      {"#{name}_max", at.(1.0), "ms"}
    ]
  end

  # All zoom levels are equally likely: spans from 200 us to everything, at any position.
  defp ask(n, answer) do
    :rand.seed(:exsss, {4, 5, 6})
    whole = n * @step

    times =
      for _ <- 1..500 do
        span = max(round(whole / :math.pow(2, :rand.uniform() * 20)), 200_000)
        from = round(:rand.uniform() * max(whole - span, 0))
        answer.(from, span)
      end

    sorted = times |> Enum.sort() |> List.to_tuple()
    fn p -> elem(sorted, trunc(p * (tuple_size(sorted) - 1))) end
  end

  defp timed(fun) do
    started = :erlang.monotonic_time(:nanosecond)
    result = fun.()
    {(:erlang.monotonic_time(:nanosecond) - started) / 1.0e6, result}
  end

  defp told({:changes, changes}, from, n) do
    for {time, state} <- changes do
      i = div(time, @step)
      true = pressed?(i) == state and (time <= from or pressed?(i - 1) != state) and i < n
    end
  end

  defp told({:states, bins}, _from, _n) do
    for {time, last, states} <- Enum.take_random(bins, 3) do
      first = div(time + @step - 1, @step)
      total = states |> Enum.map(&elem(&1, 1)) |> Enum.sum()
      true = pressed?(first + total - 1) == last
      true = Map.new(states) == Enum.frequencies_by(first..(first + total - 1), &pressed?/1)
    end
  end

  # The counts of the bins must add up to the number of points in the span. The minimum and
  # maximum of some are checked.
  defp check(bins, width, from, span, n) do
    counted(Enum.map(bins, &{elem(&1, 0), elem(&1, 4)}), width, from, span, n)
    for bin <- Enum.take_random(bins, 3), do: extremes(bin, width, n)
  end

  defp counted(counts, width, from, span, n) do
    low = Integer.floor_div(from, width) * width
    high = Integer.floor_div(from + span, width) * width + width - 1
    expected = min(div(high, @step), n - 1) - div(low + @step - 1, @step) + 1
    counted = counts |> Enum.map(&elem(&1, 1)) |> Enum.sum()
    if counted != expected, do: raise("#{counted} points in #{from}+#{span}, not #{expected}")
  end

  # Values repeat after 10,007 points, with each of 0..10,006 once.
  @period 10_007

  defp extremes({time, least, greatest, _last, count}, width, n) do
    first = div(time + @step - 1, @step)
    last = min(div(time + width - 1, @step), n - 1)

    expected =
      if last - first + 1 >= @period,
        do: {0.0, @period - 1.0},
        else: first..last |> Enum.map(&value/1) |> Enum.min_max()

    if {least, greatest} != expected,
      do: raise("#{count} points from #{time}: #{least}..#{greatest}, not #{inspect(expected)}")
  end
end

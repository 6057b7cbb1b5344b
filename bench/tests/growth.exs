for file <- ~w(empty latency), do: Code.require_file("#{file}.exs", __DIR__)

defmodule Situ.Bench.Growth do
  @moduledoc false
  # How the cost of a message, a hop, a stream or a part grows with their number. Every metric is
  # named growth_SERIES_SIZE_cpu. SCALE shortens the runs, and leaves out the largest sizes
  # below 1.
  import Situ.Bench, only: [measure_cpu: 4, sizes: 2]
  alias Situ.{Delivery, Pipeline, Time}
  alias Situ.Bench.{Empty, Latency}

  @all [pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]]

  def tests do
    [
      {"growth-messages", &messages/1},
      {"growth-chains", &chains/1},
      {"growth-streams", &streams/1},
      {"growth-joins", &joins/1},
      {"growth-branches", &branches/1},
      {"growth-latency", &latency/1},
      {"growth-startup", &startup/1}
    ]
  end

  # Messages through ten maps, with start and end. Small numbers are repeated.
  defp messages(scale) do
    for {kind, opts} <- kinds(), n <- sizes([10_000, 100_000, 1_000_000, 10_000_000], scale) do
      times = max(1, div(100_000, n))

      measure_cpu("growth_messages_#{kind}_#{n}", n * times, "us/msg", fn ->
        for _ <- 1..times, do: run_chain(10, n, opts)
      end)
    end
  end

  defp chains(scale) do
    for {kind, opts} <- kinds(), k <- [1, 2, 5, 10, 20, 50, 100, 200] do
      share = if kind == :chained, do: 2, else: 0.5
      n = max(round(1_000_000 * scale * share / max(k, 5)), 100)
      measure_cpu("growth_chain_#{kind}_#{k}", n, "us/msg", fn -> run_chain(k, n, opts) end)
    end
  end

  defp kinds, do: [chained: [], processes: [async: true]]

  defp run_chain(k, n, opts) do
    seen = :counters.new(2, [])

    {:ok, _} =
      Pipeline.run(fn p ->
        1..k
        |> Enum.reduce(numbers(p, n), fn _, stream -> Situ.map(stream, &(&1 + 1), opts) end)
        |> Situ.each(fn value ->
          :counters.add(seen, 1, 1)
          :counters.add(seen, 2, value)
        end)
      end)

    check!({:counters.get(seen, 1), :counters.get(seen, 2)}, {n, div(n * (n - 1), 2) + k * n})
  end

  # Source, map and sink for each stream. The first metric includes start and end; the second is
  # the cost of streams with one message.
  defp streams(scale) do
    for k <- sizes([1, 10, 100, 500, 1_000, 5_000], scale),
        n = max(round(1_000_000 * scale / k), 50),
        metric <- [
          measure_cpu("growth_streams_#{k}", n * k, "us/msg", fn -> run_streams(k, n) end),
          start_and_end(k, max(1, div(100, k)))
        ],
        do: metric
  end

  defp start_and_end(k, times) do
    measure_cpu("growth_stream_start_end_#{k}", k * times * 1_000, "ms/stream", fn ->
      for _ <- 1..times, do: run_streams(k, 1)
    end)
  end

  defp run_streams(k, n) do
    seen = :counters.new(1, [:write_concurrency])

    {:ok, _} =
      Pipeline.run(fn p ->
        for _ <- 1..k, do: p |> numbers(n) |> Situ.map(&(&1 + 1)) |> count(seen)
      end)

    check!(:counters.get(seen, 1), n * k)
  end

  # Streams joined one after the other: the cost per message of an input.
  defp joins(scale) do
    for k <- [2, 5, 10, 20, 50] do
      n = max(round(400_000 * scale / k), 100)
      measure_cpu("growth_joins_#{k}", n * k, "us/input", fn -> run_joins(k, n) end)
    end
  end

  defp run_joins(k, n) do
    seen = :counters.new(1, [])

    {:ok, _} =
      Pipeline.run(
        fn p ->
          [first | rest] = for _ <- 1..k, do: numbers(p, n, Time.ms(1))
          rest |> Enum.reduce(first, &Situ.join(&2, &1)) |> count(seen)
        end,
        @all
      )

    check!(:counters.get(seen, 1), n)
  end

  # Ten of the live branches take part in each message. The first message starts all.
  defp branches(scale) do
    n = max(round(100_000 * scale), 1_000)

    for keys <- sizes([10, 100, 1_000, 10_000, 100_000], scale),
        do:
          measure_cpu("growth_branches_#{keys}", n * 10, "us/part", fn ->
            run_branches(keys, n)
          end)
  end

  defp run_branches(keys, n) do
    seen = :counters.new(2, [])
    first = Map.new(1..keys, &{&1, 1})
    rest = Stream.map(1..n, fn i -> Map.new(0..9, &{rem(i * 10 + &1, keys) + 1, 1}) end)

    {:ok, _} =
      Pipeline.run(
        fn p ->
          p
          |> Situ.from_enumerable(Stream.concat([first], rest), every: 1_000)
          |> Situ.parallel(fn _key, branch -> Situ.sum(branch) end,
            of: :maps,
            until: :never,
            only_present: true
          )
          |> Situ.each(fn sums ->
            :counters.add(seen, 1, 1)
            :counters.add(seen, 2, map_size(sums))
          end)
        end,
        @all
      )

    check!({:counters.get(seen, 1), :counters.get(seen, 2)}, {n + 1, n * 10 + keys})
  end

  defp latency(scale) do
    n = max(round(10_000 * scale), 100)

    for {kind, async} <- [chained: false, processes: true],
        metric <-
          Latency.latency("growth_latency_#{kind}", n, Delivery.unlimited(), async),
        do: metric
  end

  # `bin/situ --version`, and pipelines
  defp startup(scale) do
    situ = Path.expand("../../bin/situ", __DIR__)
    program = "TIMEFORMAT='%R %U %S'; time \"$0\" --version >/dev/null 2>&1"

    [wall, user, system] =
      for(_ <- 1..max(round(5 * scale), 1), do: time_program(program, situ))
      |> Enum.zip_with(&Enum.sort/1)
      |> Enum.map(&Situ.Bench.quantile(&1, 0.5))

    situ = [
      {"growth_startup_situ", wall * 1_000, "ms"},
      {"growth_startup_situ_cpu", (user + system) * 1_000, "ms"}
    ]

    situ ++
      for {metric, value, unit} <- Empty.empty(max(round(1_000 * scale), 20)),
          do: {"growth_startup_" <> metric, value, unit}
  end

  defp time_program(program, situ) do
    {text, 0} = System.cmd("bash", ["-c", program, situ], stderr_to_stdout: true)
    text |> String.split() |> Enum.map(&String.to_float/1)
  end

  defp numbers(p, n, every \\ Time.ticks(1)),
    do: Situ.from_enumerable(p, 0..(n - 1)//1, every: every)

  defp count(stream, seen), do: Situ.each(stream, fn _ -> :counters.add(seen, 1, 1) end)

  defp check!(same, same), do: :ok
  defp check!(actual, expected), do: raise("#{inspect(actual)} instead of #{inspect(expected)}")
end

defmodule Situ.Bench.GrowthMachine do
  @moduledoc false
  # Growth that depends on the virtual machine as a whole: memory and schedulers. Each
  # size runs in a new VM.
  import Situ.Bench, only: [measure_cpu: 4, sizes: 2]
  alias Situ.{Pipeline, Store, Time}

  @all [pipeline: [replay: [interval: {0, :unbounded}, speed: :max]]]

  def tests do
    [
      {"growth-stores", &stores/1},
      {"growth-schedulers", &schedulers/1},
      {"growth-memory", &memory/1}
    ]
  end

  defp in_new_vm(function, args, flags \\ []),
    do: Situ.Bench.call_in_new_vm(__ENV__.file, {__MODULE__, function, args}, flags)

  # One store with k streams
  defp stores(scale) do
    total = round(500_000 * scale)

    for k <- sizes([1, 10, 100, 1_000, 10_000], scale),
        root = Situ.Bench.folder!(),
        metric <- in_new_vm(:store, [root, k, max(div(total, k), 100)]),
        do: metric
  end

  @doc false
  def store(root, k, n) do
    write_store(Path.join(root, "warm"), 1, 1_000)
    path = Path.join(root, "bench")

    written =
      measure_cpu("growth_store_write_#{k}", n * k, "us/msg", fn -> write_store(path, k, n) end)

    {us, names} = :timer.tc(fn -> path |> Path.join("s") |> Store.open!() |> Store.streams() end)
    if length(names) != k, do: raise("#{length(names)} of #{k} streams are listed")

    read =
      measure_cpu("growth_store_read_#{k}", n * k, "us/msg", fn -> read_store(path, k, n) end)

    [
      written,
      read,
      {"growth_store_list_#{k}", us / 1_000, "ms"},
      {"growth_store_rss_#{k}", Situ.Bench.peak_rss_mib(), "MiB"}
    ]
  after
    File.rm_rf!(root)
  end

  defp write_store(path, k, n) do
    File.mkdir_p!(path)

    {:ok, _} =
      Pipeline.run(
        fn p ->
          store = Store.create(p, "s", path)

          for i <- 1..k do
            p
            |> Situ.from_enumerable(0..(n - 1)//1, every: Time.us(100))
            |> Situ.map(& &1, type: :integer)
            |> Store.write(store, "s#{i}", type: :integer)
          end
        end,
        @all
      )
  end

  defp read_store(path, k, n) do
    seen = :counters.new(2, [:write_concurrency])

    {:ok, _} =
      Pipeline.run(fn p ->
        store = Store.importer(p, Path.join(path, "s"))

        for i <- 1..k do
          store
          |> Store.stream("s#{i}")
          |> Situ.each(fn value ->
            :counters.add(seen, 1, 1)
            :counters.add(seen, 2, value)
          end)
        end
      end)

    found = {:counters.get(seen, 1), :counters.get(seen, 2)}
    if found != {n * k, k * div(n * (n - 1), 2)}, do: raise("#{inspect(found)} was read")
  end

  # The same work on one scheduler and on two
  defp schedulers(scale) do
    n = round(300_000 * scale)

    for count <- [1, 2],
        metric <- in_new_vm(:schedule, [count, n], ["+S", "#{count}:#{count}"]),
        do: metric
  end

  @doc false
  def schedule(count, n) do
    for kind <- ~w(chained processes fanout join)a,
        metric <- schedule(kind, count, n),
        do: metric
  end

  defp schedule(kind, count, n) do
    run(kind, div(n, 10))
    started = :erlang.monotonic_time(:nanosecond)

    metric =
      measure_cpu("growth_schedulers_#{kind}_#{count}", n, "us/msg", fn -> run(kind, n) end)

    seconds = (:erlang.monotonic_time(:nanosecond) - started) / 1.0e9
    [metric, {"growth_schedulers_#{kind}_#{count}", n / seconds, "msg/s"}]
  end

  defp run(kind, n) do
    seen = :counters.new(1, [:write_concurrency])
    {:ok, _} = Pipeline.run(&build(kind, &1, n, seen), @all)
    expected = if kind == :fanout, do: 10 * n, else: n
    if :counters.get(seen, 1) != expected, do: raise("#{:counters.get(seen, 1)} of #{expected}")
  end

  defp build(:fanout, p, n, seen) do
    stream = numbers(p, n)
    for _ <- 1..10, do: count(stream, seen)
  end

  defp build(:join, p, n, seen), do: p |> numbers(n) |> Situ.join(numbers(p, n)) |> count(seen)

  defp build(kind, p, n, seen) do
    1..10
    |> Enum.reduce(numbers(p, n), fn _, stream ->
      Situ.map(stream, &(&1 + 1), async: kind == :processes)
    end)
    |> count(seen)
  end

  # Running pipelines that wait, and stopping them
  defp memory(scale) do
    for kind <- [:stage_chained, :stage_process, :stream],
        k <- sizes([1_000, 5_000], scale),
        metric <- in_new_vm(:idle, [kind, k]),
        do: metric
  end

  @doc false
  def idle(kind, k) do
    {:ok, warm} = Pipeline.start(&build_idle(kind, &1, 10))
    {:ok, _} = Pipeline.stop(warm)
    collect_garbage()
    memory = :erlang.memory(:total)
    {:ok, pipeline} = Pipeline.start(&build_idle(kind, &1, k))
    await_running(pipeline)
    collect_garbage()
    used = :erlang.memory(:total) - memory

    [
      {"growth_memory_#{kind}_#{k}", used / k / 1_024, "KiB"},
      measure_cpu("growth_stop_#{kind}_#{k}", k * 1_000, "ms", fn ->
        {:ok, _} = Pipeline.stop(pipeline)
      end)
    ]
  end

  # `start/2` returns before the stages have started.
  defp await_running(pipeline) do
    if Pipeline.state(pipeline) != :running do
      Process.sleep(50)
      await_running(pipeline)
    end
  end

  # Other processes may still have work.
  defp collect_garbage do
    Process.sleep(500)
    for pid <- Process.list(), do: :erlang.garbage_collect(pid)
  end

  defp build_idle(:stream, p, k) do
    for _ <- 1..k, do: p |> waiting() |> Situ.map(&(&1 + 1)) |> Situ.each(fn _ -> :ok end)
  end

  defp build_idle(kind, p, k) do
    1..k
    |> Enum.reduce(waiting(p), fn _, stream ->
      Situ.map(stream, &(&1 + 1), async: kind == :stage_process)
    end)
    |> Situ.each(fn _ -> :ok end)
  end

  defp waiting(p), do: Situ.repeat(p, 1, every: Time.s(3_600))

  defp numbers(p, n), do: Situ.from_enumerable(p, 0..(n - 1)//1, every: Time.ms(1))
  defp count(stream, seen), do: Situ.each(stream, fn _ -> :counters.add(seen, 1, 1) end)
end

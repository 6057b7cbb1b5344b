defmodule Situ.Bench.Latency do
  @moduledoc false
  # A 1 kHz source, ten maps and a sink for ten seconds. Measures from just before the source
  # emits until the sink receives, with chained operators (the default) and with a process for
  # each operator.
  alias Situ.{Delivery, Pipeline}

  defmodule Metronome do
    @moduledoc false
    use Situ.Component,
      outputs: [out: :integer],
      options: [count: [type: :pos_integer, required: true]]

    @impl true
    def init(opts), do: {:ok, %{left: opts[:count], timer: nil}}

    @impl true
    def handle_start(_context, state) do
      {:ok, timer} = :timer.send_interval(1, :tick)
      {[], %{state | timer: timer}}
    end

    @impl true
    def handle_info(:tick, _context, %{left: 0} = state), do: {[], state}

    def handle_info(:tick, context, %{left: 1} = state) do
      :timer.cancel(state.timer)

      {[{:out, context.now, :erlang.monotonic_time()}, {:complete, context.now}],
       %{state | left: 0}}
    end

    def handle_info(:tick, context, state),
      do: {[{:out, context.now, :erlang.monotonic_time()}], %{state | left: state.left - 1}}

    def handle_info(_other, _context, state), do: {[], state}
  end

  @policies [
    unlimited: Delivery.unlimited(),
    throttle: Delivery.throttle(),
    sync: Delivery.synchronous()
  ]

  def tests do
    plain =
      for {name, policy} <- @policies, {kind, async} <- [{"thread", false}, {"async", true}] do
        {"latency-#{kind}-#{name}",
         &latency("latency_1khz_#{kind}_k10_#{name}", count(&1), policy, async)}
      end

    plain ++ [{"latency-neighbour", &neighbour(count(&1))}]
  end

  defp count(scale), do: max(round(10_000 * scale), 10)

  @doc "Returns the metrics of `n` messages: latencies in us, and CPU time per message."
  def latency(metric, n, policy, async, beside \\ & &1) do
    # Stored outside the pipeline's processes, with one write per message.
    table = :ets.new(:latency, [:public, :set, write_concurrency: true])
    before = Situ.Bench.cpu_us()

    {:ok, _} =
      Pipeline.run(&build(&1, n, table, async, beside), pipeline: [default_policy: policy])

    cpu = Situ.Bench.cpu_us() - before
    sorted = table |> :ets.tab2list() |> Enum.map(&(elem(&1, 1) / 1_000)) |> Enum.sort()
    :ets.delete(table)
    if length(sorted) != n, do: raise("#{length(sorted)} of #{n} messages arrived")

    for {name, value} <- [
          p50: Situ.Bench.quantile(sorted, 0.5),
          p99: Situ.Bench.quantile(sorted, 0.99),
          p999: Situ.Bench.quantile(sorted, 0.999),
          max: List.last(sorted)
        ] do
      {"#{metric}_#{name}", value, "us"}
    end ++ [{metric <> "_cpu", cpu / n, "us/msg"}]
  end

  defp build(p, n, table, async, beside) do
    source = Situ.source(p, Metronome, count: n)
    beside.(source)

    1..10
    |> Enum.reduce(source, fn _, stream -> Situ.map(stream, & &1, async: async) end)
    |> Situ.each(fn sent -> :ets.insert(table, {sent, :erlang.monotonic_time() - sent}) end)
  end

  # A second process changes a map of 300,000 keys with each message. Its garbage collections
  # must not delay the chain.
  defp neighbour(n) do
    keys = 300_000
    memory = Map.new(1..keys, &{&1, {&1, "x#{&1}"}})

    beside = fn source ->
      source
      |> Situ.scan(memory, &Map.put(&2, rem(&1, keys), {&1, "y"}))
      |> Situ.map(&map_size/1)
      |> Situ.each(fn size when size >= keys -> :ok end)
    end

    latency("latency_1khz_neighbour", n, Delivery.unlimited(), false, beside)
  end
end

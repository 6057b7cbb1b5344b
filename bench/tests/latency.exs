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

  def tests do
    for {name, policy} <- [
          unlimited: Delivery.unlimited(),
          throttle: Delivery.throttle(),
          sync: Delivery.synchronous()
        ],
        {kind, async} <- [{"thread", false}, {"async", true}] do
      {"latency-#{kind}-#{name}",
       &latency("latency_1khz_#{kind}_k10_#{name}", max(round(10_000 * &1), 10), policy, async)}
    end
  end

  defp latency(metric, n, policy, async) do
    # Stored outside the pipeline's processes, with one write per message.
    table = :ets.new(:latency, [:public, :set, write_concurrency: true])

    {:ok, _} =
      Pipeline.run(
        fn p ->
          1..10
          |> Enum.reduce(Situ.source(p, Metronome, count: n), fn _, stream ->
            Situ.map(stream, & &1, async: async)
          end)
          |> Situ.each(fn sent -> :ets.insert(table, {sent, :erlang.monotonic_time() - sent}) end)
        end,
        pipeline: [default_policy: policy]
      )

    sorted = table |> :ets.tab2list() |> Enum.map(&(elem(&1, 1) / 1_000)) |> Enum.sort()
    :ets.delete(table)
    if length(sorted) != n, do: raise("#{length(sorted)} of #{n} messages arrived")

    [
      {metric <> "_p50", at(sorted, 0.50), "us"},
      {metric <> "_p99", at(sorted, 0.99), "us"},
      {metric <> "_max", List.last(sorted), "us"}
    ]
  end

  defp at(sorted, q), do: Enum.at(sorted, min(floor(length(sorted) * q), length(sorted) - 1))
end

defmodule Situ.Studio.PipelineView.Stats do
  @moduledoc """
  The statistics of a running pipeline that can be coloured by and plotted: one table.

  Totals come from one `Situ.Diagnostics.Snapshot`, rates and shares from two and the time between them.

      iex> Situ.Studio.PipelineView.Stats.format("latency_mean", 12.3456)
      "12.3 ms"
      iex> Situ.Studio.PipelineView.Stats.format("memory", 2_500_000)
      "2.50 MB"
  """
  alias Situ.Diagnostics.Snapshot

  # id, what it belongs to, name for people, unit, and how several edges of one drawn edge add up
  @table [
    {"queue", :edge, "Queue", :count, :sum},
    {"latency_mean", :edge, "Latency, mean", :ms, :max},
    {"latency_p99", :edge, "Latency, 99th percentile", :ms, :max},
    {"latency_last", :edge, "Latency, last", :ms, :max},
    {"handling", :edge, "Handling time per message", :ms, :max},
    {"busy", :edge, "Busy share of time", :percent, :max},
    {"emitted_rate", :edge, "Emitted per second", :rate, :sum},
    {"processed_rate", :edge, "Processed per second", :rate, :sum},
    {"dropped_rate", :edge, "Dropped per second", :rate, :sum},
    {"dropped_now", :edge, "Dropped, share now", :percent, :max},
    {"emitted", :edge, "Emitted in all", :count, :sum},
    {"processed", :edge, "Processed in all", :count, :sum},
    {"dropped", :edge, "Dropped in all", :count, :sum},
    {"dropped_share", :edge, "Dropped, share in all", :percent, :max},
    {"throttled", :edge, "Producer waits", :count, :max},
    {"mailbox", :node, "Mailbox", :count, :max},
    {"memory", :node, "Memory", :bytes, :max},
    {"reductions_rate", :node, "Reductions per second", :rate, :max},
    {"errors", :node, "Errors", :count, :sum},
    {"skipped", :node, "Messages lost to errors", :count, :sum},
    {"restarts", :node, "Restarts", :count, :sum}
  ]
  @by_id Map.new(@table, fn {id, of, name, unit, sum} ->
           {id, %{id: id, of: of, name: name, unit: unit, sum: sum}}
         end)

  @type id :: String.t()
  @type values :: %{id() => number()}
  @type sample :: %{
          at: Situ.Time.t(),
          edges: %{pos_integer() => values()},
          nodes: %{pos_integer() => values()}
        }

  @doc "The statistics of edges or of nodes, in the table's order: `%{id, of, name, unit, sum}`."
  @spec of(:edge | :node) :: [map()]
  def of(kind), do: for({id, ^kind, _, _, _} <- @table, do: @by_id[id])

  @doc "One row of the table."
  @spec fetch(id()) :: {:ok, map()} | :error
  def fetch(id), do: Map.fetch(@by_id, id)

  @doc "The numbers of a snapshot taken at `at` (ns); without an earlier one all rates are 0."
  @spec sample(Snapshot.t(), Situ.Time.t(), {Snapshot.t(), Situ.Time.t()} | nil) :: sample()
  def sample(%Snapshot{} = snapshot, at, earlier) do
    {edges, processes, seconds} = before(earlier, at)
    processes_now = Map.new(snapshot.processes, &{&1.number, &1})

    %{
      at: at,
      edges: Map.new(snapshot.edges, &{&1.id, edge(&1, edges[&1.id], seconds)}),
      nodes:
        Map.new(snapshot.nodes, fn node ->
          {node.id, node(node, processes_now[node.process], processes[node.process], seconds)}
        end)
    }
  end

  defp before(nil, _at), do: {%{}, %{}, 0.0}

  defp before({snapshot, time}, at) do
    {Map.new(snapshot.edges, &{&1.id, &1}), Map.new(snapshot.processes, &{&1.number, &1}),
     (at - time) / 1.0e9}
  end

  defp edge(edge, earlier, seconds) do
    earlier = earlier || edge
    processed = edge.processed - earlier.processed
    busy = edge.busy - earlier.busy
    dropped = edge.dropped - earlier.dropped

    %{
      "queue" => edge.queue,
      "latency_mean" => edge.latency_mean / 1.0e6,
      "latency_p99" => edge.latency_p99 / 1.0e6,
      "latency_last" => edge.latency_last / 1.0e6,
      "handling" => handling(busy, processed, edge),
      "busy" => share(busy, seconds * 1.0e9),
      "emitted_rate" => rate(edge.emitted - earlier.emitted, seconds),
      "processed_rate" => rate(processed, seconds),
      "dropped_rate" => rate(dropped, seconds),
      "dropped_now" => share(dropped, dropped + processed),
      "emitted" => edge.emitted,
      "processed" => edge.processed,
      "dropped" => edge.dropped,
      "dropped_share" => share(edge.dropped, edge.emitted),
      "throttled" => if(edge.throttled, do: 1, else: 0)
    }
  end

  # While nothing is handled the mean of all is the best there is.
  defp handling(busy, processed, _edge) when processed > 0, do: max(busy, 0) / processed / 1.0e6
  defp handling(_, _, %{processed: 0}), do: 0.0
  defp handling(_, _, edge), do: edge.busy / edge.processed / 1.0e6

  defp node(node, process, earlier, seconds) do
    %{
      "mailbox" => if(process, do: process.mailbox, else: 0),
      "memory" => if(process, do: process.memory, else: 0),
      "reductions_rate" => reductions(process, earlier, seconds),
      "errors" => node.errors,
      "skipped" => node.skipped,
      "restarts" => node.restarts
    }
  end

  # A process that started anew counts from nothing.
  defp reductions(%{reductions: now}, %{reductions: before}, seconds) when now >= before,
    do: rate(now - before, seconds)

  defp reductions(_, _, _), do: 0.0

  defp rate(_, seconds) when seconds <= 0, do: 0.0
  defp rate(n, seconds), do: max(n, 0) / seconds

  defp share(_, whole) when whole <= 0, do: 0.0
  defp share(part, whole), do: min(100.0, max(part, 0) * 100 / whole)

  @doc "The numbers of several edges (or nodes) drawn as one."
  @spec merge([values()]) :: values()
  def merge([one]), do: one
  def merge([]), do: %{}

  def merge(several) do
    for {id, %{sum: sum}} <- @by_id,
        values = for(%{^id => value} <- several, do: value),
        values != [],
        into: %{} do
      {id, if(sum == :sum, do: Enum.sum(values), else: Enum.max(values))}
    end
  end

  @doc "A value with its unit, short."
  @spec format(id(), number() | nil) :: String.t()
  def format(_id, nil), do: "–"

  def format(id, value) do
    case @by_id[id].unit do
      :ms -> milliseconds(value)
      :percent -> number(value) <> " %"
      :rate -> scaled(value) <> "/s"
      :bytes -> bytes(value)
      :count -> scaled(value)
    end
  end

  defp milliseconds(ms) when ms >= 100_000, do: number(ms / 1000) <> " s"
  defp milliseconds(ms) when ms > 0 and ms < 0.1, do: number(ms * 1000) <> " µs"
  defp milliseconds(ms), do: number(ms) <> " ms"

  defp bytes(b) when b >= 1.0e9, do: number(b / 1.0e9) <> " GB"
  defp bytes(b) when b >= 1.0e6, do: number(b / 1.0e6) <> " MB"
  defp bytes(b) when b >= 1.0e3, do: number(b / 1.0e3) <> " kB"
  defp bytes(b), do: "#{round(b)} B"

  defp scaled(n) when n >= 1.0e6, do: number(n / 1.0e6) <> " M"
  defp scaled(n) when n >= 1.0e4, do: number(n / 1.0e3) <> " k"
  defp scaled(n), do: number(n)

  defp number(n) when is_integer(n), do: Integer.to_string(n)
  defp number(n) when n >= 100 or n == 0, do: Integer.to_string(round(n))
  defp number(n) when n >= 10, do: :erlang.float_to_binary(n * 1.0, decimals: 1)
  defp number(n), do: :erlang.float_to_binary(n * 1.0, decimals: 2)
end

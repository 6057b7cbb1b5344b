defmodule Situ.Studio.PipelineView.Stats do
  @moduledoc """
  The statistics of a running pipeline that can be plotted or used to colour the graph.

  Rates are computed from two snapshots (`Situ.Diagnostics.Snapshot`) and the time between them, everything else from
  one. Means and recent values cover the pipeline's last averaging span. If no messages were processed in that span,
  means cover the whole run.

      iex> Situ.Studio.PipelineView.Stats.format("latency_mean", 12.3456)
      "12.3 ms"
      iex> Situ.Studio.PipelineView.Stats.format("memory", 2_500_000)
      "2.50 MB"
  """
  alias Situ.Diagnostics.Snapshot

  # id, kind of object, display name, unit, and how to combine the values of several edges drawn as one
  @table [
    {"queue", :edge, "Queue", :count, :sum},
    {"queue_mean", :edge, "Queue, mean", :count, :sum},
    {"created_mean", :edge, "Age when created, mean", :ms, :max},
    {"created_last", :edge, "Age when created, last", :ms, :max},
    {"posted_mean", :edge, "Age when posted, mean", :ms, :max},
    {"posted_last", :edge, "Age when posted, last", :ms, :max},
    {"latency_mean", :edge, "Latency, mean", :ms, :max},
    {"latency_p99", :edge, "Latency, 99th percentile", :ms, :max},
    {"latency_last", :edge, "Latency, last", :ms, :max},
    {"handling", :edge, "Handling time, mean", :ms, :max},
    {"handling_last", :edge, "Handling time, last", :ms, :max},
    {"busy", :edge, "Busy share of time", :percent, :max},
    {"emitted_rate", :edge, "Emitted per second", :rate, :sum},
    {"processed_rate", :edge, "Processed per second", :rate, :sum},
    {"dropped_rate", :edge, "Dropped per second", :rate, :sum},
    {"emitted_recent", :edge, "Emitted, recent", :count, :sum},
    {"processed_recent", :edge, "Processed, recent", :count, :sum},
    {"dropped_recent", :edge, "Dropped, recent", :count, :sum},
    {"processed_now", :edge, "Processed, recent share", :percent, :max},
    {"dropped_now", :edge, "Dropped, recent share", :percent, :max},
    {"emitted", :edge, "Emitted, total", :count, :sum},
    {"processed", :edge, "Processed, total", :count, :sum},
    {"dropped", :edge, "Dropped, total", :count, :sum},
    {"processed_share", :edge, "Processed, total share", :percent, :max},
    {"dropped_share", :edge, "Dropped, total share", :percent, :max},
    {"size_mean", :edge, "Message size, mean", :bytes, :max},
    {"size_last", :edge, "Message size, last", :bytes, :max},
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

  @doc "Lists the statistics of edges or of nodes, in the table's order: `%{id, of, name, unit, sum}`."
  @spec of(:edge | :node) :: [map()]
  def of(kind), do: for({id, ^kind, _, _, _} <- @table, do: @by_id[id])

  @doc "Fetches one row of the table."
  @spec fetch(id()) :: {:ok, map()} | :error
  def fetch(id), do: Map.fetch(@by_id, id)

  @doc "Returns the value that determines a colour. Sizes are logarithmic, because they differ by orders of magnitude."
  @spec warmth(id(), number()) :: number()
  def warmth("size_" <> _, bytes), do: :math.log(1 + bytes)
  def warmth(_id, value), do: value

  @doc "Computes the statistics of a snapshot taken at `at` (ns). Without an earlier snapshot all rates are 0."
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
    edge
    |> totals()
    |> Map.merge(recent(edge, edge.window))
    |> Map.merge(rates(edge, earlier || edge, seconds))
  end

  defp totals(edge) do
    %{
      "queue" => edge.queue,
      "created_last" => ms(edge.created_last),
      "posted_last" => ms(edge.posted_last),
      "latency_p99" => ms(edge.latency_p99),
      "latency_last" => ms(edge.latency_last),
      "handling_last" => ms(edge.handling_last),
      "emitted" => edge.emitted,
      "processed" => edge.processed,
      "dropped" => edge.dropped,
      "processed_share" => share(edge.processed, edge.emitted),
      "dropped_share" => share(edge.dropped, edge.emitted),
      "size_last" => edge.size_last,
      "throttled" => if(edge.throttled, do: 1, else: 0)
    }
  end

  # If no messages were processed recently, the overall mean is the best estimate.
  defp recent(edge, window) do
    %{
      "queue_mean" => window.queue || edge.queue_mean,
      "created_mean" => ms(window.created || edge.created_mean),
      "posted_mean" => ms(window.posted || edge.posted_mean),
      "latency_mean" => ms(window.latency || edge.latency_mean),
      "handling" => ms(window.handling || edge.handling_mean),
      "size_mean" => window.size || edge.size_mean,
      "emitted_recent" => window.emitted,
      "processed_recent" => window.processed,
      "dropped_recent" => window.dropped,
      "processed_now" => share(window.processed, window.emitted),
      "dropped_now" => share(window.dropped, window.emitted)
    }
  end

  defp rates(edge, earlier, seconds) do
    %{
      "busy" => share(edge.busy - earlier.busy, seconds * 1.0e9),
      "emitted_rate" => rate(edge.emitted - earlier.emitted, seconds),
      "processed_rate" => rate(edge.processed - earlier.processed, seconds),
      "dropped_rate" => rate(edge.dropped - earlier.dropped, seconds)
    }
  end

  defp ms(ns), do: ns / 1.0e6

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

  # The count of a restarted process starts at zero.
  defp reductions(%{reductions: now}, %{reductions: before}, seconds) when now >= before,
    do: rate(now - before, seconds)

  defp reductions(_, _, _), do: 0.0

  defp rate(_, seconds) when seconds <= 0, do: 0.0
  defp rate(n, seconds), do: max(n, 0) / seconds

  defp share(_, whole) when whole <= 0, do: 0.0
  defp share(part, whole), do: min(100.0, max(part, 0) * 100 / whole)

  @doc "Combines the statistics of several edges (or nodes) that are drawn as one."
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

  @doc "Formats a value with its unit."
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

defmodule Situ.Studio.PipelineView.Stats do
  @moduledoc false
  # Computes the statistics of a running pipeline that can be plotted or used to colour the graph.
  #
  # Rates are computed from two snapshots (`Situ.Diagnostics.Snapshot`) and the time between them,
  # everything else from one. Means and recent values cover the pipeline's last averaging span. If
  # no messages were processed in that span, means cover the whole run.
  alias Situ.Diagnostics.Snapshot

  # Each row has an id, the kind of object, a display name, a unit, and the way to combine the values of several edges.
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
  @spec list_stats(:edge | :node) :: [map()]
  def list_stats(kind), do: for({id, ^kind, _, _, _} <- @table, do: @by_id[id])

  @doc "Fetches one row of the table."
  @spec fetch(id()) :: {:ok, map()} | :error
  def fetch(id), do: Map.fetch(@by_id, id)

  @doc "Returns the value that determines a colour. Sizes are logarithmic, because they differ by orders of magnitude."
  @spec heat_value(id(), number()) :: number()
  def heat_value("size_" <> _, bytes), do: :math.log(1 + bytes)
  def heat_value(_id, value), do: value

  @doc "Computes the statistics of a snapshot taken at `at` (ns). Without an earlier snapshot all rates are 0."
  @spec compute_sample(Snapshot.t(), Situ.Time.t(), {Snapshot.t(), Situ.Time.t()} | nil) ::
          sample()
  def compute_sample(%Snapshot{} = snapshot, at, earlier) do
    {edges, processes, seconds} = index_earlier(earlier, at)
    processes_now = Map.new(snapshot.processes, &{&1.number, &1})

    %{
      at: at,
      edges: Map.new(snapshot.edges, &{&1.id, edge_values(&1, edges[&1.id], seconds)}),
      nodes:
        Map.new(snapshot.nodes, fn node ->
          {node.id,
           node_values(node, processes_now[node.process], processes[node.process], seconds)}
        end)
    }
  end

  defp index_earlier(nil, _at), do: {%{}, %{}, 0.0}

  defp index_earlier({snapshot, time}, at) do
    {Map.new(snapshot.edges, &{&1.id, &1}), Map.new(snapshot.processes, &{&1.number, &1}),
     (at - time) / 1.0e9}
  end

  defp edge_values(edge, earlier, seconds) do
    edge
    |> edge_totals()
    |> Map.merge(recent_values(edge, edge.window))
    |> Map.merge(edge_rates(edge, earlier || edge, seconds))
  end

  defp edge_totals(edge) do
    %{
      "queue" => edge.queue,
      "created_last" => to_ms(edge.created_last),
      "posted_last" => to_ms(edge.posted_last),
      "latency_p99" => to_ms(edge.latency_p99),
      "latency_last" => to_ms(edge.latency_last),
      "handling_last" => to_ms(edge.handling_last),
      "emitted" => edge.emitted,
      "processed" => edge.processed,
      "dropped" => edge.dropped,
      "processed_share" => percent_share(edge.processed, edge.emitted),
      "dropped_share" => percent_share(edge.dropped, edge.emitted),
      "size_last" => edge.size_last,
      "throttled" => if(edge.throttled, do: 1, else: 0)
    }
  end

  # If no messages were processed recently, the overall mean is the best estimate.
  defp recent_values(edge, window) do
    %{
      "queue_mean" => window.queue || edge.queue_mean,
      "created_mean" => to_ms(window.created || edge.created_mean),
      "posted_mean" => to_ms(window.posted || edge.posted_mean),
      "latency_mean" => to_ms(window.latency || edge.latency_mean),
      "handling" => to_ms(window.handling || edge.handling_mean),
      "size_mean" => window.size || edge.size_mean,
      "emitted_recent" => window.emitted,
      "processed_recent" => window.processed,
      "dropped_recent" => window.dropped,
      "processed_now" => percent_share(window.processed, window.emitted),
      "dropped_now" => percent_share(window.dropped, window.emitted)
    }
  end

  defp edge_rates(edge, earlier, seconds) do
    %{
      "busy" => percent_share(edge.busy - earlier.busy, seconds * 1.0e9),
      "emitted_rate" => per_second(edge.emitted - earlier.emitted, seconds),
      "processed_rate" => per_second(edge.processed - earlier.processed, seconds),
      "dropped_rate" => per_second(edge.dropped - earlier.dropped, seconds)
    }
  end

  defp to_ms(ns), do: ns / 1.0e6

  defp node_values(node, process, earlier, seconds) do
    %{
      "mailbox" => if(process, do: process.mailbox, else: 0),
      "memory" => if(process, do: process.memory, else: 0),
      "reductions_rate" => reductions_rate(process, earlier, seconds),
      "errors" => node.errors,
      "skipped" => node.skipped,
      "restarts" => node.restarts
    }
  end

  # The count of a restarted process starts at zero.
  defp reductions_rate(%{reductions: now}, %{reductions: before}, seconds) when now >= before,
    do: per_second(now - before, seconds)

  defp reductions_rate(_, _, _), do: 0.0

  defp per_second(_, seconds) when seconds <= 0, do: 0.0
  defp per_second(n, seconds), do: max(n, 0) / seconds

  defp percent_share(_, whole) when whole <= 0, do: 0.0
  defp percent_share(part, whole), do: min(100.0, max(part, 0) * 100 / whole)

  @doc "Combines the statistics of several edges (or nodes) that are drawn as one."
  @spec merge_values([values()]) :: values()
  def merge_values([one]), do: one
  def merge_values([]), do: %{}

  def merge_values(several) do
    for {id, %{sum: sum}} <- @by_id,
        values = for(%{^id => value} <- several, do: value),
        values != [],
        into: %{} do
      {id, if(sum == :sum, do: Enum.sum(values), else: Enum.max(values))}
    end
  end

  @doc """
  Formats a value with its unit.

      iex> Situ.Studio.PipelineView.Stats.format_value("latency_mean", 12.3456)
      "12.3 ms"
      iex> Situ.Studio.PipelineView.Stats.format_value("memory", 2_500_000)
      "2.50 MB"
  """
  @spec format_value(id(), number() | nil) :: String.t()
  def format_value(_id, nil), do: "–"

  def format_value(id, value) do
    case @by_id[id].unit do
      :ms -> format_ms(value)
      :percent -> format_number(value) <> " %"
      :rate -> format_scaled(value) <> "/s"
      :bytes -> format_bytes(value)
      :count -> format_scaled(value)
    end
  end

  defp format_ms(ms) when ms >= 100_000, do: format_number(ms / 1000) <> " s"
  defp format_ms(ms) when ms > 0 and ms < 0.1, do: format_number(ms * 1000) <> " µs"
  defp format_ms(ms), do: format_number(ms) <> " ms"

  defp format_bytes(b) when b >= 1.0e9, do: format_number(b / 1.0e9) <> " GB"
  defp format_bytes(b) when b >= 1.0e6, do: format_number(b / 1.0e6) <> " MB"
  defp format_bytes(b) when b >= 1.0e3, do: format_number(b / 1.0e3) <> " kB"
  defp format_bytes(b), do: "#{round(b)} B"

  defp format_scaled(n) when n >= 1.0e6, do: format_number(n / 1.0e6) <> " M"
  defp format_scaled(n) when n >= 1.0e4, do: format_number(n / 1.0e3) <> " k"
  defp format_scaled(n), do: format_number(n)

  defp format_number(n) when is_integer(n), do: Integer.to_string(n)
  defp format_number(n) when n >= 100 or n == 0, do: Integer.to_string(round(n))
  defp format_number(n) when n >= 10, do: :erlang.float_to_binary(n * 1.0, decimals: 1)
  defp format_number(n), do: :erlang.float_to_binary(n * 1.0, decimals: 2)
end

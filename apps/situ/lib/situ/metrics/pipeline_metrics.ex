defmodule Situ.Metrics.PipelineMetrics do
  @moduledoc false
  # Builds the metrics of pipelines from their snapshots. `Situ.Metrics` describes them. Pure.
  alias Situ.Diagnostics.Snapshot
  alias Situ.{Metrics, Time}

  @edge_counters [
    {"messages_emitted_total", :emitted,
     "Messages that an output has added to the queue of an input."},
    {"messages_processed_total", :processed, "Messages that an input has taken from its queue."},
    {"messages_dropped_total", :dropped, "Messages that the delivery policy has dropped."}
  ]
  @node_counters [
    {"component_errors_total", :errors, "Errors of a component."},
    {"component_restarts_total", :restarts, "Restarts of a component."},
    {"component_skipped_total", :skipped, "Messages that a component has skipped after errors."}
  ]
  @process_gauges [
    {"process_memory_bytes", :memory, "Memory of the process that runs a component."},
    {"process_mailbox_messages", :mailbox, "Erlang messages waiting for a process."}
  ]

  @doc "Builds the metrics of these snapshots."
  @spec build([Snapshot.t()]) :: [Metrics.metric()]
  def build(snapshots) do
    edges =
      for s <- snapshots,
          names = port_names(s),
          e <- s.edges,
          e.kind == :process,
          do: {s, names, e}

    nodes = for s <- snapshots, node <- s.nodes, do: {s, node}
    processes = for s <- snapshots, %{nodes: [_ | _]} = process <- s.processes, do: {s, process}

    pipeline_metrics(snapshots) ++
      edge_metrics(edges) ++ node_metrics(nodes) ++ process_metrics(processes)
  end

  defp pipeline_metrics(snapshots) do
    running = for s <- snapshots, do: {label(s), if(s.state == :running, do: 1, else: 0)}
    uptime = for s <- snapshots, do: {label(s), Time.to_seconds(max(s.time - s.start_time, 0))}

    [
      gauge(
        "pipeline_running",
        "Whether a pipeline is running (1), or starts or stops (0).",
        running
      ),
      gauge("pipeline_uptime_seconds", "Time of the pipeline's clock since its start.", uptime)
    ]
  end

  defp edge_metrics(edges) do
    counters =
      for {name, key, help} <- @edge_counters,
          do: counter(name, help, for(e <- edges, do: {edge_labels(e), value(e, key)}))

    queue = for e <- edges, do: {edge_labels(e), value(e, :queue)}
    busy = for e <- edges, do: {edge_labels(e), Time.to_seconds(value(e, :busy))}

    counters ++
      [
        gauge("queue_messages", "Messages that wait in the queue of an input.", queue),
        counter("handling_seconds_total", "Time that an input has spent with messages.", busy),
        %{
          name: "situ_latency_seconds",
          type: :summary,
          help: "Time from the originating time of a message to its delivery.",
          samples: Enum.flat_map(edges, &latency_samples/1)
        }
      ]
  end

  defp latency_samples({_, _, edge} = e) do
    labels = edge_labels(e)
    count = edge.processed

    [
      {labels ++ [quantile: "0.99"], Time.to_seconds(round(edge.latency_p99)), :quantile},
      {labels, Time.to_seconds(round((edge.latency_mean || 0) * count)), :sum},
      {labels, count, :count}
    ]
  end

  defp node_metrics(nodes) do
    for {name, key, help} <- @node_counters do
      samples =
        for {s, node} <- nodes, do: {label(s) ++ [component: node.path], Map.get(node, key)}

      counter(name, help, samples)
    end
  end

  defp process_metrics(processes) do
    for {name, key, help} <- @process_gauges do
      samples =
        for {s, %{nodes: [first | _]} = process} <- processes,
            do: {label(s) ++ [component: first], Map.get(process, key)}

      gauge(name, help, samples)
    end
  end

  defp label(snapshot), do: [pipeline: snapshot.pipeline]

  # Edges refer to components by their ids.
  defp port_names(snapshot), do: Map.new(snapshot.nodes, &{&1.id, &1.path})

  defp edge_labels({snapshot, names, edge}) do
    label(snapshot) ++
      [
        from: "#{names[edge.from]}.#{edge.from_output}",
        to: "#{names[edge.to]}.#{edge.to_input}"
      ]
  end

  defp value({_, _, edge}, key), do: Map.get(edge, key)

  defp gauge(name, help, samples),
    do: %{name: "situ_" <> name, type: :gauge, help: help, samples: samples}

  defp counter(name, help, samples),
    do: %{name: "situ_" <> name, type: :counter, help: help, samples: samples}
end

defmodule Situ.Metrics.PipelineMetrics do
  @moduledoc false
  # Builds the metrics of pipelines from their snapshots and counters. `Situ.Metrics` describes them.
  alias Situ.Diagnostics.Snapshot
  alias Situ.Metrics.LatencyHistogram
  alias Situ.Ports.Counters
  alias Situ.{Metrics, Time}

  # The largest number of connections, components and processes of a pipeline that have their own series.
  @most 500
  @others "(others)"

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

  @doc "Builds the metrics of these pipelines; each is a snapshot and its counters by connection."
  @spec build_metrics([{Snapshot.t(), %{pos_integer() => Counters.t()}}]) :: [Metrics.metric()]
  def build_metrics(pipelines) do
    pipelines = number_names(pipelines)
    snapshots = Enum.map(pipelines, &elem(&1, 0))
    edges = Enum.flat_map(pipelines, &list_edges/1)
    nodes = Enum.flat_map(snapshots, &list_nodes/1)
    processes = Enum.flat_map(snapshots, &list_processes/1)

    pipeline_metrics(snapshots) ++
      edge_metrics(edges) ++
      for({name, key, help} <- @node_counters, do: counter(name, help, samples(nodes, key))) ++
      for({name, key, help} <- @process_gauges, do: gauge(name, help, samples(processes, key)))
  end

  # Two pipelines may have the same name, but every series needs its own labels.
  defp number_names(pipelines) do
    {pipelines, _} =
      Enum.map_reduce(pipelines, %{}, fn {%{pipeline: name} = snapshot, counters}, seen ->
        n = Map.get(seen, name, 0) + 1
        label = if n == 1, do: name, else: "#{name} (#{n})"
        {{%{snapshot | pipeline: label}, counters}, Map.put(seen, name, n)}
      end)

    pipelines
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
      for {name, key, help} <- @edge_counters, do: counter(name, help, samples(edges, key))

    busy = for {labels, values} <- edges, do: {labels, Time.to_seconds(values.busy)}

    counters ++
      [
        gauge(
          "queue_messages",
          "Messages that wait in the queue of an input.",
          samples(edges, :queue)
        ),
        counter("handling_seconds_total", "Time that an input has spent with messages.", busy),
        %{
          name: "situ_latency_seconds",
          type: :histogram,
          help: "Time from the originating time of a message to its delivery.",
          samples:
            Enum.flat_map(edges, fn {labels, values} ->
              LatencyHistogram.to_samples(values.latency, labels)
            end)
        }
      ]
  end

  # Edges refer to components by their ids.
  defp list_edges({snapshot, counters}) do
    names = Map.new(snapshot.nodes, &{&1.id, &1.path})

    rows =
      for %{id: id} = edge when is_map_key(counters, id) <- snapshot.edges do
        from = "#{names[edge.from]}.#{edge.from_output}"
        to = "#{names[edge.to]}.#{edge.to_input}"
        values = Map.take(edge, [:emitted, :processed, :dropped, :queue, :busy])
        latency = LatencyHistogram.read(Map.fetch!(counters, id))
        {label(snapshot) ++ [from: from, to: to], Map.put(values, :latency, latency)}
      end

    join_surplus(rows, label(snapshot) ++ [from: @others, to: @others])
  end

  defp list_nodes(snapshot) do
    rows =
      for node <- snapshot.nodes,
          do: {label(snapshot) ++ [component: node.path], Map.from_struct(node)}

    join_surplus(rows, label(snapshot) ++ [component: @others])
  end

  defp list_processes(snapshot) do
    rows =
      for %{nodes: [first | _]} = process <- snapshot.processes,
          do: {label(snapshot) ++ [component: first], Map.from_struct(process)}

    join_surplus(rows, label(snapshot) ++ [component: @others])
  end

  # Prometheus keeps every series, so their number must not grow with the branches of a pipeline.
  defp join_surplus(rows, labels) do
    case Enum.split(rows, @most) do
      {rows, []} -> rows
      {rows, surplus} -> rows ++ [{labels, surplus |> Enum.map(&elem(&1, 1)) |> add_values()}]
    end
  end

  defp add_values(maps) do
    Enum.reduce(maps, fn values, sums ->
      Map.merge(sums, values, fn _key, a, b -> add_value(a, b) end)
    end)
  end

  defp add_value(a, b) when is_number(a) and is_number(b), do: a + b
  defp add_value(%LatencyHistogram{} = a, b), do: LatencyHistogram.add(a, b)
  defp add_value(a, _b), do: a

  defp label(snapshot), do: [pipeline: snapshot.pipeline]

  defp samples(rows, key), do: for({labels, %{^key => value}} <- rows, do: {labels, value})

  defp gauge(name, help, samples),
    do: %{name: "situ_" <> name, type: :gauge, help: help, samples: samples}

  defp counter(name, help, samples),
    do: %{name: "situ_" <> name, type: :counter, help: help, samples: samples}
end

defmodule Situ.Diagnostics.SnapshotBuilder do
  @moduledoc false
  # Builds a snapshot from the server's data (graph, stages, counters, tallies) without asking any component.
  alias Situ.{Delivery, Graph, Type}
  alias Situ.Diagnostics.{Averages, Edge, Node, Process, Snapshot, Window}
  alias Situ.Graph.Vertex
  alias Situ.Ports.{Counters, ErrorCounters}

  @doc "Builds a snapshot. `view` holds the graph, the stages, the vertices of taps, and counters, totals and windows."
  @spec take_snapshot(map()) :: Snapshot.t()
  def take_snapshot(view) do
    processes = group_stages(view.stages)
    positions = index_vertices(processes)
    names = Map.new(view.graph.stream_names, fn {name, port} -> {port, name} end)
    entries = Map.new(view.graph.edges, fn {id, edge} -> {elem(edge.to, 0), id} end)
    view = Map.merge(view, %{names: names, entries: entries})

    %Snapshot{
      pipeline: view.name,
      state: view.state,
      time: view.time,
      start_time: view.start_time,
      progress: view.progress,
      scopes: view.graph.scopes |> Map.keys() |> Enum.sort_by(&{String.length(&1), &1}),
      nodes:
        view.graph.vertices
        |> Map.values()
        |> Enum.sort_by(& &1.id)
        |> Enum.map(&describe_node(&1, view, positions)),
      edges:
        view.graph.edges
        |> Map.values()
        |> Enum.sort_by(& &1.id)
        |> Enum.map(&describe_edge(&1, view, positions)),
      processes: Enum.map(processes, &describe_process/1)
    }
  end

  # Stages that share a process have the number of the first of them.
  defp index_vertices(processes) do
    for [%{id: number} | _] = together <- processes,
        stage <- together,
        {vertex, index} <- Enum.with_index(stage.vertices),
        into: %{},
        do: {vertex.id, {Map.put(stage, :number, number), index}}
  end

  defp group_stages(stages) do
    stages
    |> Enum.sort_by(& &1.id)
    |> Enum.group_by(&(&1.pid || &1.id))
    |> Map.values()
    |> Enum.sort_by(&hd(&1).id)
  end

  defp describe_node(%Vertex{} = vertex, view, positions) do
    {stage, index} = Map.get(positions, vertex.id, {nil, 0})
    tally = if stage, do: ErrorCounters.read_counts(stage.tally, index), else: %{}

    struct!(
      %Node{
        id: vertex.id,
        path: vertex.path,
        scope: vertex.scope,
        module: if(vertex.module == :operator, do: "Operator", else: inspect(vertex.module)),
        kind: node_kind(vertex, view),
        state: node_state(stage),
        process: stage && stage.number,
        description: stage && Map.get(view.descriptions, stage.id),
        inputs: Enum.map(vertex.inputs, &describe_port(&1, nil)),
        outputs:
          Enum.map(vertex.outputs, &describe_port(&1, stream_name(view, vertex, elem(&1, 0))))
      },
      tally
    )
  end

  defp node_state(nil), do: :running
  defp node_state(stage), do: stage.state

  defp node_kind(%Vertex{module: :operator}, _view), do: :operator

  defp node_kind(%Vertex{id: id} = vertex, view) do
    cond do
      id in view.taps -> :tap
      Vertex.source?(vertex) -> :source
      true -> :component
    end
  end

  defp describe_port({name, port}, stream),
    do: %{name: Atom.to_string(name), type: Type.to_string(port.type), stream: stream}

  defp stream_name(view, vertex, output) do
    with nil <- view.names[{vertex.id, output}],
         do: Graph.StreamNames.default_name(vertex.path, output, vertex.outputs)
  end

  defp describe_edge(%{id: id} = edge, view, positions) do
    {from, output} = edge.from
    {to, input} = edge.to

    base = %Edge{
      id: id,
      from: from,
      from_output: Atom.to_string(output),
      to: to,
      to_input: Atom.to_string(input),
      policy: Delivery.display_name(edge.policy)
    }

    case view.counters do
      %{^id => _} -> struct!(base, edge_counts(id, view))
      _ -> describe_inline_edge(base, view, positions, from)
    end
  end

  defp edge_counts(id, view) do
    totals = Map.fetch!(view.totals, id)

    view.counters
    |> Map.fetch!(id)
    |> Counters.read_values(totals)
    |> Map.merge(Averages.overall_means(totals))
    |> Map.put(:window, Map.get(view.windows, id, %Window{}))
  end

  # A chain has no queues inside, so its inner edges show the numbers of the chain's entry.
  defp describe_inline_edge(base, view, positions, from) do
    with {stage, _} <- Map.get(positions, from, nil),
         entry when entry != nil <- view.entries[hd(stage.vertices).id],
         true <- Map.has_key?(view.counters, entry) do
      %{window: window} = numbers = edge_counts(entry, view)
      window = %{window | emitted: window.processed, dropped: 0, queue: nil, size: nil}

      struct!(
        base,
        Map.merge(numbers, %{
          kind: :inline,
          emitted: numbers.processed,
          queue: 0,
          queue_mean: 0.0,
          dropped: 0,
          throttled: false,
          size_last: 0,
          size_mean: 0,
          window: window
        })
      )
    else
      _ -> %{base | kind: :inline}
    end
  end

  defp describe_process([stage | _] = together) do
    paths = for stage <- together, vertex <- stage.vertices, do: vertex.path
    keys = [:memory, :message_queue_len, :reductions, :status, :current_function]

    case stage.pid && Elixir.Process.info(stage.pid, keys) do
      nil ->
        %Process{number: stage.id, nodes: paths, status: "ended"}

      info ->
        {module, function, arity} = info[:current_function] || {:none, :none, 0}

        %Process{
          number: stage.id,
          pid: inspect(stage.pid),
          nodes: paths,
          memory: info[:memory],
          mailbox: info[:message_queue_len],
          reductions: info[:reductions],
          status: Atom.to_string(info[:status]),
          busy_in: Exception.format_mfa(module, function, arity)
        }
    end
  end
end

defmodule Situ.Cluster.SnapshotMerge do
  @moduledoc false
  # Merges the snapshots of a deployment's parts into one: the ids of each part are shifted into a separate range, and
  # the connection from an outlet to an inlet becomes an edge, as within a pipeline. Pure.
  alias Situ.Diagnostics.Snapshot

  @id_range 1_000_000

  @spec merge_parts(String.t(), [{part :: String.t(), node(), Snapshot.t()}]) :: Snapshot.t()
  def merge_parts(name, parts) do
    shifted =
      for {{_, node, s}, i} <- Enum.with_index(parts), do: {node, shift_ids(s, i * @id_range)}

    nodes = for {node, s} <- shifted, n <- s.nodes, do: {node, n}

    producers =
      for {_, n} <- nodes,
          not link_node?(n),
          %{stream: s} <- n.outputs,
          s != nil,
          into: %{},
          do: {s, n}

    inlets = for {_, %{path: "Inlet " <> stream, id: id}} <- nodes, into: %{}, do: {id, stream}
    outlets = for {_, %{path: "Outlet " <> _, id: id}} <- nodes, into: MapSet.new(), do: id

    edges =
      for {_, s} <- shifted,
          e <- s.edges,
          e.to not in outlets,
          do: join_edge(e, inlets, producers)

    snapshots = for {_, s} <- shifted, do: s

    %Snapshot{
      pipeline: name,
      state: merge_states(Enum.map(snapshots, & &1.state)),
      time: snapshots |> Enum.map(& &1.time) |> Enum.max(fn -> 0 end),
      start_time: snapshots |> Enum.map(& &1.start_time) |> Enum.min(fn -> 0 end),
      progress: snapshots |> Enum.map(& &1.progress) |> Enum.min(fn -> 0.0 end),
      scopes: snapshots |> Enum.flat_map(& &1.scopes) |> Enum.uniq(),
      nodes: for({node, n} <- nodes, not link_node?(n), do: add_node_name(n, node)),
      edges: Enum.reject(edges, &is_nil/1),
      processes: Enum.flat_map(snapshots, & &1.processes)
    }
  end

  defp shift_ids(%Snapshot{} = s, offset) do
    %{
      s
      | nodes:
          for(
            n <- s.nodes,
            do: %{n | id: n.id + offset, process: n.process && n.process + offset}
          ),
        edges:
          for(
            e <- s.edges,
            do: %{e | id: e.id + offset, from: e.from + offset, to: e.to + offset}
          ),
        processes: for(p <- s.processes, do: %{p | number: p.number + offset})
    }
  end

  defp link_node?(%{path: "Inlet " <> _}), do: true
  defp link_node?(%{path: "Outlet " <> _}), do: true
  defp link_node?(_node), do: false

  # The part that produces the stream may not be running on any node at the moment.
  defp join_edge(edge, inlets, producers) do
    with {:ok, stream} <- Map.fetch(inlets, edge.from), %{} = producer <- producers[stream] do
      output = Enum.find(producer.outputs, &(&1.stream == stream)).name
      %{edge | from: producer.id, from_output: output, kind: :process}
    else
      :error -> edge
      nil -> nil
    end
  end

  defp add_node_name(n, node),
    do: %{n | description: Enum.join(["on #{node}" | List.wrap(n.description)], "; ")}

  defp merge_states(states) do
    Enum.find([:building, :starting, :running, :stopping], :completed, &(&1 in states))
  end
end

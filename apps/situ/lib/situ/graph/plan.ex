defmodule Situ.Graph.Plan do
  @moduledoc false
  # Decides which vertices share a process, and which edges become queues between processes. Pure.
  #
  # A light operator joins the process of the preceding light operator if that has no other consumer, no explicit
  # policy (except synchronous or `throttle(1)`) is between them, neither has `async: true`, and both have the same
  # `on_error:` and belong to the same composite (which can be stopped alone). It joins the process of a component
  # with one output if the policy between them is synchronous, `throttle(1)` (unless the component is a source that
  # cannot wait), or the pipeline's default throttle. No messages are then in flight between them.
  #
  # Such stages, and components that are as light (see `c:Situ.Component.share_process?/0`), then share a process with
  # their neighbours (see Situ.Stage.SharedProcess) unless a policy between them drops messages, one of them has
  # `async: true`, restarts or skips messages, or they belong to different composites.
  # See docs/adr/0010-one-process-per-component-or-chain.md.
  alias Situ.{Delivery, Error, Graph}
  alias Situ.Graph.Vertex

  defstruct stages: [], edges: [], inline: []

  @typedoc "Stages with the same `group` share a process."
  @type stage :: %{id: pos_integer(), vertices: [Vertex.t()], group: pos_integer() | nil}
  @type t :: %__MODULE__{
          stages: [stage()],
          edges: [Graph.Edge.t()],
          inline: [Graph.Edge.t()]
        }

  @spec compile(Graph.t()) :: {:ok, t()} | {:error, Error.t()}
  def compile(%Graph{} = graph) do
    edges = graph.edges |> Map.values() |> Enum.sort_by(& &1.id)

    with :ok <- check_inputs(graph, edges), do: compile_checked(graph, edges)
  end

  defp compile_checked(graph, edges) do
    outgoing = Enum.group_by(edges, &elem(&1.from, 0))
    {inline, process} = Enum.split_with(edges, &inline_edge?(graph, outgoing, &1))
    {:ok, build_plan(graph, inline, unbound_cycles(graph, process, edges))}
  end

  @doc "Compiles the plan of only the vertices `fresh`, which are added to a graph that is already running."
  @spec compile_part(Graph.t(), MapSet.t(pos_integer())) :: {:ok, t()} | {:error, Error.t()}
  def compile_part(%Graph{} = graph, fresh) do
    edges = for {_, %{to: {to, _}} = edge} <- graph.edges, MapSet.member?(fresh, to), do: edge

    vertices = Map.take(graph.vertices, MapSet.to_list(fresh))
    edges = Enum.sort_by(edges, & &1.id)

    with :ok <- check_inputs(%{graph | vertices: vertices}, edges) do
      {inner, outer} = Enum.split_with(edges, &MapSet.member?(fresh, elem(&1.from, 0)))
      part = %{graph | vertices: vertices, edges: Map.new(inner, &{&1.id, &1})}
      {:ok, plan} = compile_checked(part, inner)
      {:ok, %{plan | edges: outer ++ plan.edges}}
    end
  end

  defp build_plan(graph, inline, process) do
    next = Map.new(inline, fn edge -> {elem(edge.from, 0), elem(edge.to, 0)} end)
    inner = MapSet.new(Map.values(next))

    stages =
      for id <- Enum.sort(Map.keys(graph.vertices)), not MapSet.member?(inner, id) do
        %{
          id: id,
          vertices: graph |> follow_chain(next, id) |> Enum.map(&Map.fetch!(graph.vertices, &1))
        }
      end

    groups = group_stages(stages, process)
    stages = for stage <- stages, do: Map.put(stage, :group, groups[stage.id])
    %__MODULE__{stages: stages, edges: process, inline: inline}
  end

  # Returns the group of each stage that shares a process with another one.
  defp group_stages(stages, edges) do
    light =
      for %{id: id, vertices: vertices} = stage <- stages,
          light_stage?(stage),
          vertex <- vertices,
          into: %{},
          do: {vertex.id, {id, vertex}}

    digraph = :digraph.new()
    for {_id, {stage, _vertex}} <- light, do: :digraph.add_vertex(digraph, stage)

    for edge <- edges,
        {from, sender} <- List.wrap(light[elem(edge.from, 0)]),
        {to, receiver} <- List.wrap(light[elem(edge.to, 0)]),
        sender.scope == receiver.scope and not Delivery.lossy?(edge.policy),
        do: :digraph.add_edge(digraph, from, to)

    groups = :digraph_utils.components(digraph)
    :digraph.delete(digraph)
    for [_, _ | _] = ids <- groups, id <- ids, into: %{}, do: {id, Enum.min(ids)}
  end

  defp light_stage?(%{vertices: vertices}) do
    Enum.all?(vertices, fn vertex ->
      vertex.on_error == :stop and vertex.unit == nil and not vertex.async and
        (vertex.module == :operator or Vertex.shares_process?(vertex))
    end)
  end

  defp follow_chain(graph, next, id) do
    case next do
      %{^id => following} -> [id | follow_chain(graph, next, following)]
      _ -> [id]
    end
  end

  defp inline_edge?(graph, outgoing, edge) do
    from = Map.fetch!(graph.vertices, elem(edge.from, 0))
    to = Map.fetch!(graph.vertices, elem(edge.to, 0))

    to.module == :operator and not to.async and match?([_], Map.fetch!(outgoing, from.id)) and
      can_share_process?(from, to, edge)
  end

  defp can_share_process?(%{async: true}, _to, _edge), do: false

  defp can_share_process?(%{module: :operator} = from, to, edge) do
    from.on_error == to.on_error and
      (edge.policy.kind == :synchronous or
         (from.scope == to.scope and (not edge.explicit or one_at_a_time?(edge.policy))))
  end

  defp can_share_process?(%{outputs: [_]}, _to, %{policy: %{kind: :synchronous}}), do: true

  defp can_share_process?(%{outputs: [_]}, _to, %{policy: %{kind: :throttle}, explicit: false}),
    do: true

  # A device that cannot wait must keep running while the operator works, so the two do not share a process.
  defp can_share_process?(%{outputs: [_], scope: scope} = from, %{scope: scope}, %{policy: policy}),
       do: one_at_a_time?(policy) and not Vertex.push_source?(from)

  defp can_share_process?(_from, _to, _edge), do: false

  # Within one process there is only ever one message at a time, without two wake-ups per message.
  defp one_at_a_time?(%Delivery{kind: :throttle, window: 1}), do: true
  defp one_at_a_time?(_policy), do: false

  defp check_inputs(graph, edges) do
    connected = MapSet.new(edges, & &1.to)

    missing =
      for {id, vertex} <- graph.vertices,
          {name, port} <- vertex.inputs,
          not port.optional,
          not MapSet.member?(connected, {id, name}),
          do: {id, vertex.path, name}

    case Enum.sort(missing) do
      [] ->
        :ok

      [{_, path, name} | _] ->
        {:error,
         Error.new(:unconnected_input, "input #{path}.#{name} is not connected",
           why: "the input is required",
           fix: "connect a stream to it, or declare it as {type, optional: true}"
         )}
    end
  end

  # Back-pressure around a cycle would stall it forever, so edges on a cycle are unbounded.
  defp unbound_cycles(graph, process, edges) do
    case find_cycles(Map.keys(graph.vertices), edges) do
      cycles when cycles == %{} -> process
      cycles -> Enum.map(process, &unbound_edge(&1, cycles))
    end
  end

  defp unbound_edge(edge, cycles) do
    {from, to} = {cycles[elem(edge.from, 0)], cycles[elem(edge.to, 0)]}

    if from != nil and from == to and not Delivery.lossy?(edge.policy),
      do: %{edge | policy: %{edge.policy | window: :infinity}},
      else: edge
  end

  # Returns each vertex on a cycle with the number of its strongly connected component.
  defp find_cycles(ids, edges) do
    digraph = :digraph.new()
    Enum.each(ids, &:digraph.add_vertex(digraph, &1))
    for edge <- edges, do: :digraph.add_edge(digraph, elem(edge.from, 0), elem(edge.to, 0))
    groups = :digraph_utils.cyclic_strong_components(digraph)
    :digraph.delete(digraph)
    for {group, n} <- Enum.with_index(groups), id <- group, into: %{}, do: {id, n}
  end
end

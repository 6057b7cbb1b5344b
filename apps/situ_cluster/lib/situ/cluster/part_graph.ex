defmodule Situ.Cluster.PartGraph do
  @moduledoc false
  # Builds the graph of one part: its own components, an inlet for every stream that comes from another part, and an
  # outlet for every stream that leaves it. Pure.
  alias Situ.Cluster.{InletComponent, OutletComponent, Plan}
  alias Situ.{Delivery, Graph}
  alias Situ.Graph.{Edge, Additions, Vertex}

  # The window is larger than inside a part, since sending to another node is efficient only in batches.
  @window 4_000

  @doc "Builds the graph of part `name`; the functions in `links` return the options of a stream's inlet and outlet."
  @spec build_part_graph(Graph.t(), Plan.t(), String.t(), %{inlet: fun(), outlet: fun()}) ::
          Graph.t()
  def build_part_graph(%Graph{} = graph, plan, name, links) do
    %{ids: ids} = Map.fetch!(plan.parts, name)
    others = graph.vertices |> Map.keys() |> MapSet.new() |> MapSet.difference(ids)
    part_graph = Additions.remove_vertices(graph, others)

    part_graph =
      Enum.reduce(
        incoming_streams(graph, plan, ids),
        part_graph,
        &add_inlet(&1, &2, graph, links.inlet)
      )

    part_graph =
      Enum.reduce(
        Plan.outgoing_streams(plan, name),
        part_graph,
        &add_outlet(&1, &2, links.outlet)
      )

    # A part without sources runs by the wall clock, because its inputs determine its time.
    if has_sources?(graph, ids), do: part_graph, else: %{part_graph | proposals: []}
  end

  @doc "Returns whether the part contains a source."
  @spec has_sources?(Graph.t(), MapSet.t(pos_integer())) :: boolean()
  def has_sources?(graph, ids), do: Enum.any?(ids, &(graph.vertices[&1].inputs == []))

  # Returns the streams of other parts, each with its edges into this part.
  defp incoming_streams(graph, plan, ids) do
    for {_, stream} <- plan.streams,
        not MapSet.member?(ids, elem(stream.from, 0)),
        edges = edges_into(graph, stream.from, ids),
        edges != [],
        do: {stream, edges}
  end

  defp edges_into(graph, from, ids) do
    for {_, %{from: ^from, to: {to, _}} = edge} <- graph.edges, MapSet.member?(ids, to), do: edge
  end

  defp add_inlet({stream, edges}, graph, full_graph, options) do
    {id, output} = stream.from
    port = full_graph.vertices[id].outputs[output]

    {vertex, graph} =
      add_vertex(graph, %Vertex{
        id: graph.next_vertex,
        module: InletComponent,
        path: "Inlet " <> stream.name,
        opts: options.(stream),
        outputs: [out: port],
        # A message has already been held until its time in the part that made it, and the clocks of machines differ.
        holds: false
      })

    edges
    |> Enum.sort_by(& &1.id)
    |> Enum.reduce(graph, fn edge, graph -> put_edge(graph, %{edge | from: {vertex.id, :out}}) end)
  end

  defp add_outlet(stream, graph, options) do
    {vertex, graph} =
      add_vertex(graph, %Vertex{
        id: graph.next_vertex,
        module: OutletComponent,
        path: "Outlet " <> stream.name,
        opts: options.(stream),
        inputs: [in: %{type: :any, optional: false}],
        check: :off
      })

    edge = %Edge{
      id: graph.next_edge,
      from: stream.from,
      to: {vertex.id, :in},
      policy: Delivery.unlimited(window: @window),
      explicit: true
    }

    put_edge(%{graph | next_edge: edge.id + 1}, edge)
  end

  # The optional callbacks of a module can only be detected once it is loaded.
  defp add_vertex(graph, %Vertex{module: module} = vertex) do
    Code.ensure_loaded!(module)

    {vertex,
     %{
       graph
       | vertices: Map.put(graph.vertices, vertex.id, vertex),
         paths: Map.put(graph.paths, vertex.path, vertex.id),
         next_vertex: vertex.id + 1
     }}
  end

  defp put_edge(graph, edge) do
    %{
      graph
      | edges: Map.put(graph.edges, edge.id, edge),
        connected: Map.put(graph.connected, edge.to, edge.id)
    }
  end
end

defmodule Situ.Pipeline.Dynamic.Guarantee do
  @moduledoc false
  # When the pipeline's module has a new version, replaces the functions with which delivery policies protect messages
  # (`guarantee:`), at both ends of each edge and in the values that a restart begins with.
  alias Situ.Graph
  alias Situ.Pipeline.{Stages, State}

  @doc """
  Replaces the current guarantees with the guarantees of `graph`, another version of the same pipeline; returns the
  processes that receive new ones.
  """
  @spec reload(State.t(), Graph.t()) :: {State.t(), [pid()]}
  def reload(state, graph) do
    fresh =
      for {_, edge} <- graph.edges, into: %{}, do: {edge_key(graph, edge), edge.policy.guarantee}

    changed =
      for {id, edge} <- state.graph.edges,
          keep? = fresh[edge_key(state.graph, edge)],
          keep? != edge.policy.guarantee,
          do: {id, keep?}

    stages =
      for {id, _keep?} <- changed,
          %{from: from, to: to} <- [state.wires.links[id]],
          stage <- [from, to],
          %{^stage => %{pid: pid}} when pid != nil <- [state.stages],
          uniq: true,
          do: pid

    {Enum.reduce(changed, state, fn {id, keep?}, state -> replace_guarantee(state, id, keep?) end),
     stages}
  end

  defp edge_key(graph, %{from: {from, output}, to: {to, input}}),
    do: {graph.vertices[from].path, output, graph.vertices[to].path, input}

  defp replace_guarantee(state, id, keep?) do
    state = put_in(state.graph.edges[id].policy.guarantee, keep?)

    case state.wires.links do
      %{^id => link} ->
        links = Map.put(state.wires.links, id, put_in(link.policy.guarantee, keep?))

        for stage <- [link.from, link.to],
            reduce: %{state | wires: %{state.wires | links: links}} do
          state -> Stages.send_request(state, stage, {:guarantee, id, keep?})
        end

      _ ->
        state
    end
  end
end

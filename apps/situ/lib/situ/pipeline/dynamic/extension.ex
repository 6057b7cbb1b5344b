defmodule Situ.Pipeline.Dynamic.Extension do
  @moduledoc false
  # Adds components to a running pipeline and removes them. The caller builds on a copy of the graph with its own range
  # of ids. The server merges the new components and plans them like any graph, and the life cycle starts them.
  #
  # If each addition took effect immediately, half a graph would run while the rest is being
  # built. A copy needs no lock, and its own range of ids avoids collisions. New components never
  # share a process with running ones. If one of them fails to start, all of them are removed.
  alias Situ.{Error, Graph}
  alias Situ.Graph.{Additions, Plan}
  alias Situ.Pipeline.{Stages, State}

  # Each extension reserves this many ids; they need to be unique, not dense.
  @numbers 1_000_000

  @doc "Returns a copy of the graph to build on, and reserves ids for it."
  @spec reserve_ids(State.t()) :: {Graph.t(), State.t()}
  def reserve_ids(%{graph: graph} = state),
    do: {graph, %{state | graph: Additions.reserve_ids(graph, @numbers)}}

  @doc "Returns the new components as a plan for the life cycle, or an error if they do not fit the running graph."
  @spec add_components(State.t(), Graph.t()) :: {:ok, State.t(), map()} | {:error, Error.t()}
  def add_components(state, added) do
    with {:ok, graph, fresh} <- Additions.merge_additions(state.graph, added),
         {:ok, plan} <- Plan.compile_part(graph, fresh),
         {:ok, lent} <- find_lent_edges(state, plan) do
      {state, members} =
        Stages.add_plan(%{state | graph: graph}, plan, Map.new(lent), added?: true)

      links = Map.take(state.wires.links, Enum.map(plan.edges, & &1.id))
      lent = Enum.map(lent, fn {id, _} -> id end)
      {:ok, state, %{members: members, links: links, lent: lent}}
    end
  end

  # Returns the edges from streams of the running graph, each with the stage that owns the output.
  defp find_lent_edges(state, plan) do
    new = for stage <- plan.stages, vertex <- stage.vertices, into: MapSet.new(), do: vertex.id

    Enum.reduce_while(plan.edges, {:ok, []}, fn %{from: {from, _}} = edge, {:ok, lent} ->
      with false <- MapSet.member?(new, from),
           {:ok, stage} <- State.fetch_output_stage(state, from) do
        {:cont, {:ok, [{edge.id, stage.id} | lent]}}
      else
        true -> {:cont, {:ok, lent}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  @doc "Asks the producer to add a new stage without demand; the stage misses no message from then on."
  @spec lend_output(State.t(), term()) :: State.t()
  def lend_output(state, tag) do
    link = state.wires.links[tag]
    counters = state.wires.counters[tag]
    consumer = state.stages[link.to]
    policy = Stages.subscriber_policy(link.policy, consumer)

    Stages.send_request(
      state,
      link.from,
      {:lend, tag, link.output, consumer.pid, counters, policy}
    )
  end

  @doc """
  Removes stages from the graph. The life cycle drops each of them after its process has ended.
  """
  @spec remove_vertices(State.t(), [pos_integer()]) :: State.t()
  def remove_vertices(state, ids) do
    removed =
      for id <- ids,
          %{vertices: vertices} <- [state.stages[id]],
          vertex <- vertices,
          into: MapSet.new(),
          do: vertex.id

    %{state | graph: Additions.remove_vertices(state.graph, removed)}
  end

  @doc "Returns whether a stage was removed and its process has ended."
  @spec stage_removed?(State.t(), pos_integer()) :: boolean()
  def stage_removed?(state, id) do
    case state.stages do
      %{^id => %{vertices: [head | _]}} -> not is_map_key(state.graph.vertices, head.id)
      _ -> false
    end
  end
end

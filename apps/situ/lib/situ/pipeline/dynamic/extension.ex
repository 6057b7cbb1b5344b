defmodule Situ.Pipeline.Dynamic.Extension do
  @moduledoc false
  # Adds components to a running pipeline and removes them. The caller builds on a copy of the graph with its own range
  # of ids. The server merges the new components and plans them like any graph, and the life cycle starts them.
  alias Situ.{Error, Graph}
  alias Situ.Graph.{Extension, Plan}
  alias Situ.Pipeline.{Stages, State}

  # Each extension reserves this many ids; they need to be unique, not dense.
  @numbers 1_000_000

  @doc "Returns a copy of the graph to build on, and reserves ids for it."
  @spec offer(State.t()) :: {Graph.t(), State.t()}
  def offer(%{graph: graph} = state),
    do: {graph, %{state | graph: Extension.advance(graph, @numbers)}}

  @doc "Returns the new components as a plan for the life cycle, or an error if they do not fit the running graph."
  @spec take(State.t(), Graph.t()) :: {:ok, State.t(), map()} | {:error, Error.t()}
  def take(state, added) do
    with {:ok, graph, fresh} <- Extension.merge(state.graph, added),
         {:ok, plan} <- Plan.extend(graph, fresh),
         {:ok, lent} <- lent(state, plan) do
      {state, members} = Stages.add(%{state | graph: graph}, plan, Map.new(lent), added?: true)
      links = Map.take(state.wires.links, Enum.map(plan.edges, & &1.id))
      lent = Enum.map(lent, fn {id, _} -> id end)
      {:ok, state, %{members: members, links: links, lent: lent}}
    end
  end

  # Returns the edges from streams of the running graph, each with the stage that owns the output.
  defp lent(state, plan) do
    new = for stage <- plan.stages, vertex <- stage.vertices, into: MapSet.new(), do: vertex.id

    Enum.reduce_while(plan.edges, {:ok, []}, fn %{from: {from, _}} = edge, {:ok, lent} ->
      with false <- MapSet.member?(new, from),
           {:ok, stage} <- State.outlet(state, from) do
        {:cont, {:ok, [{edge.id, stage.id} | lent]}}
      else
        true -> {:cont, {:ok, lent}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  @doc "Asks the producer to add a new stage without demand; the stage misses no message from then on."
  @spec lend(State.t(), term()) :: State.t()
  def lend(state, tag) do
    link = state.wires.links[tag]
    counters = state.wires.counters[tag]
    pid = state.stages[link.to].pid
    Stages.tell(state, link.from, {:lend, tag, link.output, pid, counters, link.policy})
  end

  @doc """
  Removes stages from the graph. The life cycle drops each of them after its process has ended.
  """
  @spec forget(State.t(), [pos_integer()]) :: State.t()
  def forget(state, ids) do
    gone =
      for id <- ids,
          %{vertices: vertices} <- [state.stages[id]],
          vertex <- vertices,
          into: MapSet.new(),
          do: vertex.id

    %{state | graph: Extension.without(state.graph, gone)}
  end

  @doc "Returns whether a stage was removed and its process has ended."
  @spec forgotten?(State.t(), pos_integer()) :: boolean()
  def forgotten?(state, id) do
    case state.stages do
      %{^id => %{vertices: [head | _]}} -> not is_map_key(state.graph.vertices, head.id)
      _ -> false
    end
  end
end

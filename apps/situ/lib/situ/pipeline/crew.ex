defmodule Situ.Pipeline.Crew do
  @moduledoc false
  # The stages of a pipeline: spawned, and what has become of them.
  alias Situ.Graph.Vertex
  alias Situ.Pipeline.{Launch, Life, Reaper}
  alias Situ.Stage
  alias Situ.Stage.{Output, Tally}

  @doc "A stage for each of the plan, and what they share."
  @spec spawn_all(Life.t()) :: Life.t()
  def spawn_all(%{plan: plan} = state) do
    Reaper.watch(self())
    links = Launch.links(plan)

    state = %{
      state
      | links: links,
        active: links,
        counters: Launch.counters(plan.edges ++ tails(plan)),
        order: Enum.map(plan.stages, & &1.id),
        pending: MapSet.new(plan.stages, & &1.id),
        completable:
          for(
            %{id: id, vertices: [head | _]} <- plan.stages,
            Vertex.source?(head),
            into: MapSet.new(),
            do: id
          )
    }

    Enum.reduce(
      plan.stages,
      state,
      &spawn(&2, &1.id, &1.vertices, Tally.new(length(&1.vertices)))
    )
  end

  @doc "One stage, new or again."
  @spec spawn(Life.t(), pos_integer(), [Vertex.t()], Tally.t()) :: Life.t()
  def spawn(state, id, vertices, tally) do
    marks = marks(state.stages[id], vertices)

    pid =
      Stage.spawn_link(%{
        marks: marks,
        id: id,
        server: self(),
        handle: state.handle,
        vertices: vertices,
        tally: tally,
        tail_counters: tail_counters(state, vertices),
        sizes: state.settings.message_sizes
      })

    stage = %{
      id: id,
      pid: pid,
      vertices: vertices,
      tally: tally,
      control: control(state.stages[id]),
      marks: marks,
      state: :running
    }

    %{state | stages: Map.put(state.stages, id, stage), pids: Map.put(state.pids, pid, id)}
  end

  # The cell that holds the time up to which messages count; a stage that is there again keeps its own.
  defp control(nil) do
    cell = :atomics.new(1, signed: true)
    :atomics.put(cell, 1, Stage.never())
    cell
  end

  defp control(stage), do: stage.control

  # Only what may be spawned again has to know how far it came.
  defp marks(nil, [%{on_error: :stop} | _]), do: nil

  defp marks(nil, vertices),
    do: vertices |> Enum.map(&length(&1.outputs)) |> Enum.sum() |> Output.marks()

  defp marks(stage, _vertices), do: stage.marks

  defp tails(plan) do
    heads =
      for %{vertices: [%{module: module, id: id}, _ | _]} <- plan.stages,
          module != :operator,
          do: id

    Enum.filter(plan.inline, &(elem(&1.from, 0) in heads))
  end

  # The edge from a component into the operators that share its process is counted like a queue.
  defp tail_counters(state, [%{id: id}, %{id: next} | _]) do
    case Enum.find(state.plan.inline, &(elem(&1.from, 0) == id and elem(&1.to, 0) == next)) do
      nil -> nil
      edge -> state.counters[edge.id]
    end
  end

  defp tail_counters(_state, _vertices), do: nil

  @doc "What becomes of running stages; `:dead` becomes of all, `:ended` of all that are not dead."
  @spec mark(Life.t(), Enumerable.t(), atom()) :: Life.t()
  def mark(state, ids, how) do
    stages =
      Enum.reduce(ids, state.stages, fn id, stages ->
        Map.update!(stages, id, &%{&1 | state: becomes(&1.state, how)})
      end)

    %{state | stages: stages}
  end

  defp becomes(_state, :dead), do: :dead
  defp becomes(:dead, _how), do: :dead
  defp becomes(_state, :ended), do: :ended
  defp becomes(:running, how), do: how
  defp becomes(state, _how), do: state

  @spec ids(Life.t()) :: MapSet.t(pos_integer())
  def ids(state), do: state.stages |> Map.keys() |> MapSet.new()
end

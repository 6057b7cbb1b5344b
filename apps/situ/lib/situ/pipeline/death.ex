defmodule Situ.Pipeline.Death do
  @moduledoc false
  # Stages that end before their time, or fail: begun again, or the pipeline's end.
  alias Situ.Error
  alias Situ.Graph.Cycle
  alias Situ.Pipeline.{Crew, Ending, Inputs, Life, Notice, Part}
  alias Situ.Stage.Tally

  @doc "A process of the pipeline ended."
  @spec exited(Life.t(), pid(), term()) :: Life.t()
  def exited(state, pid, reason) do
    case Map.pop(state.pids, pid) do
      {nil, _} -> state
      {id, pids} -> gone(%{state | pids: pids}, id, state.stages[id], reason)
    end
  end

  defp gone(state, id, stage, reason) do
    ref = state.phase == :running && Part.of(state, id)

    if ref,
      do: Part.died(state, ref, id, killed(stage, reason)),
      else: died(state, id, stage, reason)
  end

  defp died(state, id, %{state: how}, _reason) when how in [:dead, :ended],
    do: Life.next_step(%{state | pending: MapSet.delete(state.pending, id)})

  defp died(%{step: :quit} = state, id, _stage, _reason) do
    Life.next_step(%{Crew.mark(state, [id], :dead) | pending: MapSet.delete(state.pending, id)})
  end

  defp died(
         %{phase: :running} = state,
         id,
         %{vertices: [%{on_error: policy} | _]} = stage,
         reason
       )
       when policy in [:skip, :restart] do
    Tally.restarted(stage.tally, 0)
    state = state |> Notice.noted(killed(stage, reason)) |> Inputs.interrupted(id)
    Crew.spawn(state, id, stage.vertices, stage.tally)
  end

  defp died(state, id, stage, reason) do
    state = Notice.failed(dead(state, id), killed(stage, reason))
    stop_after_death(state)
  end

  defp stop_after_death(%{step: :up} = state), do: Ending.quit(state)

  defp stop_after_death(%{phase: :running} = state),
    do: Ending.begin(%{state | by_hand: true}, Life.now(state))

  defp stop_after_death(state), do: Life.next_step(state)

  @doc "The stage is no more: its neighbours take it as closed."
  @spec dead(Life.t(), pos_integer()) :: Life.t()
  def dead(state, id) do
    time = if state.clock, do: Life.now(state), else: 0

    for {tag, link} <- state.active, link.from == id or link.to == id, link.from != link.to do
      other = if link.from == id, do: link.to, else: link.from
      send(state.stages[other].pid, {:situ, {:peer_gone, tag, time}})
    end

    active = state.active |> Enum.reject(fn {_, link} -> link.to == id end) |> Map.new()

    %{
      Crew.mark(state, [id], :dead)
      | active: active,
        order: List.delete(state.order, id),
        pending: MapSet.delete(state.pending, id),
        completable: MapSet.delete(state.completable, id)
    }
  end

  defp killed(stage, reason) do
    path = hd(stage.vertices).path

    Error.new(:component_killed, "#{path} was killed: #{inspect(reason, limit: 8)}",
      meta: %{component: path, reason: reason}
    )
  end

  @doc "A stage says that it failed: it takes nothing any more."
  @spec failed(Life.t(), pos_integer(), Error.t()) :: Life.t()
  def failed(state, id, error) do
    error = Cycle.explain(error, state.graph)
    state = Notice.failed(Crew.mark(state, [id], :failed), error)
    state = %{state | completable: MapSet.delete(state.completable, id)}

    if state.phase == :running,
      do: Ending.begin(%{state | by_hand: true}, Life.now(state)),
      else: %{state | by_hand: true}
  end
end

defmodule Situ.Lifecycle.Stall do
  @moduledoc false
  # Finds the stages that do not end in time, names and kills them. Pure.
  # The server looks twice, the stop timeout apart. If no counter has moved in between and nothing has happened, the
  # busy stages are stuck; if none is busy, those that still owe an answer. A stage that makes ever more of one message,
  # as of a gap of fifty years, gives up by itself at the second look when the stop is by hand.
  alias Situ.Error
  alias Situ.Lifecycle.{Links, State}
  import Situ.Lifecycle.State

  @typedoc """
  Whether anything has moved, which stages wait for a message and have none, and whether one waits for somebody
  outside of the pipeline, or for its clock.
  """
  @type seen :: %{moved?: boolean(), idle: MapSet.t(State.id()), patient?: boolean()}

  @spec watched(State.t(), :all | reference(), seen()) :: State.t()
  def watched(%{phase: phase, ending: %{wish: wish}} = state, :all, seen)
      when phase == :stopping or (phase == :starting and wish != nil) do
    state = if seen.moved?, do: state, else: kill_all(state, late(state, seen))
    state = if state.ending.by_hand, do: tell(state, alive(state), :looked), else: state
    act(state, {:watch, state.limits.stop_timeout, :all})
  end

  def watched(%{phase: :running} = state, ref, seen) when is_map_key(state.parts, ref) do
    busy = for id <- state.parts[ref].ids, id not in seen.idle, state.stages[id].alive?, do: id
    state = if seen.moved?, do: state, else: kill(state, busy)
    act(state, {:watch, state.limits.stop_timeout, ref})
  end

  def watched(state, _which, _seen), do: state

  defp kill(state, ids), do: Enum.reduce(ids, state, &act(&2, {:kill, &1}))

  defp kill_all(state, []), do: state

  defp kill_all(state, ids) do
    members = Enum.map(ids, &state.stages[&1])
    state = kill(state, ids)
    if Enum.all?(members, & &1.tap?), do: state, else: error(state, stuck(members, state))
  end

  defp late(state, seen) do
    alive = alive(state)

    case Enum.reject(alive, &(&1 in seen.idle)) do
      [] -> if waits?(state, seen), do: [], else: Enum.filter(alive, &owes?(&1, state))
      busy -> busy
    end
  end

  # An end by hand waits for nobody.
  defp waits?(state, seen), do: seen.patient? and not state.ending.by_hand

  defp owes?(id, %{step: :close} = state), do: not Links.free?(state.links, id)
  defp owes?(id, state), do: MapSet.member?(state.pending, id)

  defp stuck(members, state) do
    names = Enum.map_join(members, ", ", & &1.path)

    Error.new(
      :stuck,
      "#{names} did not end within #{state.limits.stop_timeout} ms and was killed",
      why: "it neither took a message nor answered the stop",
      fix:
        "look for a loop or a call that never returns; raise stop_timeout: when it is just slow",
      meta: %{component: names}
    )
  end
end

defmodule Situ.Lifecycle.StuckStages do
  @moduledoc false
  # Finds the stages that do not end in time, names them in an error and kills them. Pure.
  # The server measures twice, `stop_timeout` apart. If no counter has moved and nothing has happened in between, the
  # busy stages are stuck; if no stage is busy, the stages that still owe a reply are stuck. After a manual stop, a
  # stage that emits ever more messages from one message (by filling a gap of fifty years, for instance) gives up at
  # the second measurement.
  alias Situ.Error
  alias Situ.Lifecycle.{Links, State}
  import Situ.Lifecycle.State

  @typedoc """
  The result of two measurements: whether anything has moved, which stages wait for a message and have none, and whether
  a stage waits for something outside the pipeline or for its clock.
  """
  @type seen :: %{moved?: boolean(), idle: MapSet.t(State.id()), patient?: boolean()}

  @spec kill_stuck_stages(State.t(), :all | reference(), seen()) :: State.t()
  def kill_stuck_stages(%{phase: phase, ending: %{wish: wish}} = state, :all, seen)
      when phase == :stopping or (phase == :starting and wish != nil) do
    state = if seen.moved?, do: state, else: kill_and_report(state, list_late_stages(state, seen))

    state =
      if state.ending.by_hand, do: send_to_stages(state, alive_ids(state), :looked), else: state

    add_action(state, {:watch, state.limits.stop_timeout, :all})
  end

  def kill_stuck_stages(%{phase: :running} = state, ref, seen)
      when is_map_key(state.parts, ref) do
    busy = for id <- state.parts[ref].ids, id not in seen.idle, state.stages[id].alive?, do: id
    state = if seen.moved?, do: state, else: kill_stages(state, busy)
    add_action(state, {:watch, state.limits.stop_timeout, ref})
  end

  def kill_stuck_stages(state, _which, _seen), do: state

  defp kill_stages(state, ids), do: Enum.reduce(ids, state, &add_action(&2, {:kill, &1}))

  defp kill_and_report(state, []), do: state

  defp kill_and_report(state, ids) do
    members = Enum.map(ids, &state.stages[&1])
    state = kill_stages(state, ids)

    if Enum.all?(members, & &1.tap?),
      do: state,
      else: add_error(state, stuck_error(members, state))
  end

  defp list_late_stages(state, seen) do
    alive = alive_ids(state)

    case Enum.reject(alive, &(&1 in seen.idle)) do
      [] -> if may_wait?(state, seen), do: [], else: Enum.filter(alive, &owes_reply?(&1, state))
      busy -> busy
    end
  end

  # A manual stop does not wait for anything outside the pipeline.
  defp may_wait?(state, seen), do: seen.patient? and not state.ending.by_hand

  defp owes_reply?(id, %{step: :close} = state), do: not Links.no_inputs?(state.links, id)
  defp owes_reply?(id, state), do: MapSet.member?(state.pending, id)

  defp stuck_error(members, state) do
    names = Enum.map_join(members, ", ", & &1.path)

    Error.new(
      :stuck,
      "#{names} did not end within #{state.limits.stop_timeout} ms and was killed",
      why: "it neither took a message nor replied to the stop request",
      fix:
        "look for a loop or a call that never returns; if it is only slow, raise stop_timeout:",
      meta: %{component: names}
    )
  end
end

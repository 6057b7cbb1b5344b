defmodule Situ.Stage.Production do
  @moduledoc false
  # Makes a source produce messages while there is demand, and stops it on request.
  alias Situ.{Clock, Error}
  alias Situ.Clock.Timers
  alias Situ.Ports.{Output, Outputs, ErrorCounters}
  alias Situ.Stage.{CallbackRunner, ActionRunner, ErrorPolicy, Scheduling, SourceState, State}

  @most 1_000
  # Not beyond the clock if it is enforced, because messages ahead of it have to be held.
  @most_ahead 8

  @doc "Asks a pull source for messages while there is room; returns whether it may have more."
  @spec produce_messages(State.t(), Situ.Time.t()) :: {:more | :enough, State.t()}
  def produce_messages(state, now) do
    room = if SourceState.can_produce?(state.source), do: room(state), else: 0

    if room < 1 or Outputs.any_held?(state.outputs),
      do: {:enough, state},
      else: ask(state, room, now)
  end

  defp room(state) do
    room = min(Outputs.available_room(state.outputs), @most)
    room = if state.context.enforced?, do: min(room, @most_ahead), else: room
    if state.outputs.tail, do: min(room, state.pace.slice), else: room
  end

  defp ask(state, room, now) do
    before =
      {Outputs.progress_mark(state.outputs), Outputs.repeated_count(state.outputs), errors(state)}

    state = state |> CallbackRunner.call_callback(:handle_demand, [room], now) |> judge(before)
    state = ActionRunner.send_pending(%{state | pace: Scheduling.enlarge_heap(state.pace, room)})

    # The slice is for the light operators after it, which run in the same time slice.
    state =
      if state.outputs.tail,
        do: %{
          state
          | pace: Scheduling.resize_slice(state.pace, room, Clock.now(state.clock) - now)
        },
        else: state

    if state.source.idle or state.source.completed or state.phase == :failed,
      do: {:enough, state},
      else: {:more, state}
  end

  defp judge(%{phase: :failed} = state, _before), do: state

  defp judge(state, {progress, repeated, errors}) do
    emitted? = Outputs.progress_mark(state.outputs) != progress
    harmed? = errors(state) != errors
    repeated? = Outputs.repeated_count(state.outputs) != repeated
    # How often one may restart is counted elsewhere.
    restarts? = harmed? and state.callback.on_error == :restart
    {harmed?, repeated?} = {harmed? and not restarts?, repeated? or restarts?}

    case SourceState.judge_reply(state.source, emitted?, harmed?, repeated?) do
      {:ok, source} -> %{state | source: source}
      {:no_way_on, _source} -> ErrorPolicy.fail_stage(state, no_way_on(state))
    end
  end

  defp errors(state), do: ErrorCounters.read_counts(state.tally, 0).errors

  defp no_way_on(state) do
    path = state.callback.path

    Error.new(
      :no_way_on,
      "#{path} failed #{SourceState.max_strikes()} times without emitting anything",
      why: "a source that raises has no message to skip, so it would raise again and again",
      fix: "handle the error in handle_demand/3, or use on_error: :stop",
      meta: %{component: path}
    )
  end

  @doc "Stops the source; it sends nothing later than `final`."
  @spec stop_source(State.t(), Situ.Time.t()) :: State.t()
  def stop_source(%{source: %{stopping: nil}} = state, final) do
    state = %{
      state
      | source: SourceState.request_stop(state.source, final),
        outputs:
          state.outputs
          |> Outputs.set_waiting(false)
          |> Outputs.map_outputs(&Output.drop_held_after(&1, final)),
        timers: Timers.drop_after(state.timers, final)
    }

    # Light operators whose source is gone, as while a unit restarts, have nothing to stop.
    state =
      if state.phase == :failed or state.callback == nil,
        do: state,
        else: CallbackRunner.call_callback(state, :handle_stop, [final], Clock.now(state.clock))

    if state.source.stopping == :asked,
      do: ErrorPolicy.report_source_stopped(state),
      else: State.wake_source(state)
  end

  def stop_source(state, _final), do: state

  @doc "Stops the source immediately; messages that it holds back are lost."
  @spec stop_now(State.t()) :: State.t()
  def stop_now(%{source: %{stopping: :done}} = state), do: state

  def stop_now(state) do
    state = %{
      state
      | outputs:
          state.outputs
          |> Outputs.set_waiting(false)
          |> Outputs.map_outputs(&Output.drop_all_held/1)
    }

    ErrorPolicy.report_source_stopped(state)
  end

  @doc "Reports a completion or stop that was waiting until no message is held back."
  @spec report_released(State.t()) :: State.t()
  def report_released(%{source: %{completing: nil, stopping: stopping}} = state)
      when stopping != :held,
      do: state

  def report_released(state) do
    if Outputs.any_held?(state.outputs) do
      state
    else
      time = state.source.completing
      state = if time, do: ActionRunner.announce_end(state, time), else: state
      if state.source.stopping == :held, do: ErrorPolicy.report_source_stopped(state), else: state
    end
  end
end

defmodule Situ.Stage.Source do
  @moduledoc false
  # What a source does besides answering: it produces while there is demand, and stops when it is asked to.
  alias Situ.{Clock, Stage}
  alias Situ.Stage.{Fault, Outlet, Ports, Pump, Tally, Turn}

  @pull 1_000
  @strikes 10

  # A pull source: asked while there is room, no further than the clock when that is enforced.
  @spec produce(Stage.t(), Situ.Time.t(), integer()) :: Stage.t()
  def produce(
        %{source: :pull, completed: false, idle: false, stopping: stopping} = state,
        now,
        _final
      )
      when stopping in [nil, :stopping] do
    room = min(Ports.room(state), @pull)
    room = if state.enforce, do: min(room, 8), else: room
    room = if state.tail, do: min(room, state.slice), else: room

    if room < 1 or Ports.holding?(state) do
      state
    else
      before = {emitted(state), repeated(state), Tally.read(state.tally, 0).errors}
      state = Turn.call(state, :handle_demand, [room, %{state.context | now: now}], now)
      state = Ports.settle(judge(state, before))

      state =
        if state.tail, do: Pump.resize(state, room, Clock.now(state.clock) - now), else: state

      if state.idle or state.completed or state.failed, do: state, else: Ports.schedule(state)
    end
  end

  def produce(state, _now, _final), do: state

  # A source that has nothing now is asked again when something happens; one that raised is asked again at once, with
  # `:skip` and `:restart`, but not for ever: there is no message that would be used up by the next try.
  defp judge(%{failed: true} = state, _before), do: state

  defp judge(state, {emitted, repeated, errors}) do
    unharmed? = Tally.read(state.tally, 0).errors == errors

    cond do
      emitted(state) != emitted -> %{state | strikes: 0}
      unharmed? and repeated(state) != repeated -> state
      unharmed? -> %{state | idle: true}
      state.strikes < @strikes -> %{state | strikes: state.strikes + 1}
      true -> Fault.fail(state, no_way_on(state))
    end
  end

  defp no_way_on(state) do
    Situ.Error.new(
      :no_way_on,
      "#{state.head.path} failed #{@strikes + 1} times without emitting anything",
      why: "a source that raises has no message to skip: it meets the same error again",
      fix: "handle the error in handle_demand/3, or use on_error: :stop",
      meta: %{component: state.head.path}
    )
  end

  defp emitted(state), do: Enum.map(state.outlets, fn {_, o} -> {o.seq, o.last_time} end)

  # What was posted before (by one that began anew), or dropped for its time: neither rest nor progress.
  defp repeated(state), do: Enum.map(state.outlets, fn {_, o} -> o.repeated end)

  @doc "Asked to stop: nothing later than `final` goes out any more."
  @spec stop(Stage.t(), Situ.Time.t()) :: Stage.t()
  def stop(%{stopping: nil} = state, final) do
    state = Ports.each_outlet(%{state | final: final, stopping: :asked}, &Outlet.cut(&1, final))
    timers = Enum.filter(state.timers, fn {time, _} -> time <= final end)
    state = %{state | timers: timers}

    state =
      if state.failed,
        do: state,
        else:
          Turn.call(
            state,
            :handle_stop,
            [final, %{state.context | now: Clock.now(state.clock)}],
            nil
          )

    if state.stopping == :asked, do: stopped(state), else: Pump.pump(%{state | idle: false})
  end

  def stop(state, _final), do: state

  @doc "It has posted its last message; told once nothing is held back any more."
  @spec stopped(Stage.t()) :: Stage.t()
  def stopped(%{stopping: :done} = state), do: state

  def stopped(state) do
    if Ports.holding?(state) and not state.failed do
      %{state | stopping: :held}
    else
      Stage.report(state, :source_stopped)
      %{state | stopping: :done}
    end
  end
end

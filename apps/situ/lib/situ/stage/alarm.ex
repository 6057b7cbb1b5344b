defmodule Situ.Stage.Alarm do
  @moduledoc false
  # One timer of the VM for all that waits for the clock: timers of the component, messages ahead of time.
  alias Situ.{Clock, Stage}
  alias Situ.Stage.{Actions, Outlet, Ports, Posting, Pump, Source, Turn}

  @doc "Something is due."
  @spec ring(Stage.t()) :: Stage.t()
  def ring(state) do
    now = Clock.now(state.clock)
    state = Ports.each_outlet(state, &Posting.release(&1, now))
    {due, later} = Enum.split_while(state.timers, fn {time, _} -> time <= now end)
    state = Enum.reduce(due, %{state | timers: later, idle: false}, &fire(&1, &2, now))
    state |> Ports.settle() |> released() |> Pump.pump() |> arm()
  end

  defp fire({_time, key}, %{failed: false} = state, now),
    do: Turn.call(state, :handle_info, [{:timer, key}, %{state.context | now: now}], now)

  defp fire(_timer, state, _now), do: state

  defp released(state) do
    if Ports.holding?(state) do
      state
    else
      state = if state.completing, do: Actions.complete(state, state.completing), else: state
      if state.stopping == :held, do: Source.stopped(state), else: state
    end
  end

  @doc "Sets the timer for what is due next."
  @spec arm(Stage.t()) :: Stage.t()
  def arm(%{timers: [], enforce: false, alarm: nil} = state), do: state

  def arm(state) do
    case next_due(state) do
      nil -> disarm(state)
      due -> rearm(state, due, Clock.wait_ms(state.clock, due))
    end
  end

  defp rearm(%{alarm: {due, wait, _}} = state, due, wait) when wait != :never, do: state

  defp rearm(state, due, wait) do
    state = disarm(state)

    if wait == :never,
      do: state,
      else: %{state | alarm: {due, wait, Process.send_after(self(), {:situ_alarm, due}, wait)}}
  end

  defp disarm(%{alarm: nil} = state), do: state

  defp disarm(%{alarm: {_, _, ref}} = state) do
    Process.cancel_timer(ref)
    %{state | alarm: nil}
  end

  defp next_due(state) do
    held = for {_, outlet} <- state.outlets, time = Outlet.next_time(outlet), do: time
    timers = for {time, _} <- Enum.take(state.timers, 1), do: time
    Enum.min(held ++ timers, fn -> nil end)
  end
end

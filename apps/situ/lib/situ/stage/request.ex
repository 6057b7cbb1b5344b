defmodule Situ.Stage.Request do
  @moduledoc false
  # What the pipeline's server asks of a stage: each request is one step of its life cycle.
  alias Situ.{Clock, Stage}

  alias Situ.Stage.{
    Alarm,
    Attach,
    Fault,
    Inlet,
    Outlet,
    Ports,
    Posting,
    Probe,
    Pump,
    Setup,
    Source,
    Subscriber,
    Turn
  }

  @spec handle(term(), Stage.t()) :: {:noreply, Stage.t()} | {:stop, :normal, Stage.t()}
  def handle({:start, wiring}, state) do
    state = Setup.wire(state, wiring)
    state.early |> Enum.reverse() |> Enum.each(&send(self(), &1))
    state = %{state | early: []}

    state =
      if state.kind == :component,
        do: Turn.call(state, :handle_start, [state.context], nil),
        else: state

    Stage.report(state, :started)
    {:noreply, state}
  end

  def handle(:run, state) do
    Enum.each(state.inlets, fn {_, inlet} -> Ports.ask(inlet, inlet.window) end)
    {:noreply, Pump.pump(Alarm.arm(%{state | phase: :running}))}
  end

  def handle({:ask, tag}, state) do
    with %{^tag => inlet} <- state.inlets, do: Ports.ask(inlet, inlet.window)
    {:noreply, state}
  end

  def handle({:stop, final}, state), do: {:noreply, state |> Source.stop(final) |> Pump.pump()}

  def handle(:stop_now, %{stopping: :done} = state), do: {:noreply, state}

  def handle(:stop_now, state) do
    state = Ports.each_outlet(state, &%{&1 | future: [], future_rear: []})
    {:noreply, Source.stopped(%{state | stopping: :stopping})}
  end

  def handle({:finalize, time}, state) do
    state = state |> Ports.settle() |> Ports.close(time) |> Ports.settle()
    Probe.close(state, time)
    Stage.report(state, :finalized)
    {:noreply, Alarm.arm(state)}
  end

  # Subscribers from outside the pipeline still get what they have coming, at their own pace.
  def handle(:quit, state) do
    state = state |> Ports.settle() |> Ports.close(state.final || 0)

    if Ports.drained?(state),
      do: {:stop, :normal, state},
      else: {:noreply, %{state | quitting: true}}
  end

  def handle({:tap, tag, output, index, pid, counters}, state) do
    state = tap(state, tag, {output, index}, pid, counters)
    Stage.report(state, {:tapped, tag})
    {:noreply, state}
  end

  # A consumer is to end before this stage does: it gets what waits for it, and the closing mark.
  def handle({:cut, tag, time}, state) do
    state = Ports.each_outlet(state, &Posting.release(&1, min(time, Clock.now(state.clock))))
    state = state |> Ports.settle() |> Ports.cut(tag, time)
    {:noreply, Pump.pump(state)}
  end

  def handle({:untap, tag}, state) do
    state = Ports.unsubscribe(state, &(&1.tag == tag))
    {:noreply, state |> Probe.remove(tag) |> Pump.pump()}
  end

  def handle({:lend, tag, output, pid, counters}, state) do
    {answer, state} = Attach.lend(state, tag, output, pid, counters)
    Stage.report(state, {:lent, tag, answer})
    {:noreply, Pump.pump(state)}
  end

  def handle({:attach, request, last, wiring}, state),
    do: answered(Attach.input(state, request, last, wiring), wiring.tag, state)

  def handle({:detach, ref, request}, state),
    do: answered(Attach.release(state, request), ref, state)

  def handle({:leave, input}, state), do: {:noreply, Pump.pump(Attach.left(state, input))}
  def handle({:fail, error}, state), do: {:noreply, Pump.pump(Fault.fail(state, error))}
  def handle(:clock, state), do: {:noreply, state |> Alarm.arm() |> Pump.pump()}
  def handle({:peer, tag, pid}, state), do: {:noreply, Setup.rewire(state, tag, pid)}

  def handle({:peer_gone, tag, time}, state) do
    case state.inlets do
      %{^tag => inlet} ->
        {:noreply, Pump.pump(Ports.put_inlet(state, tag, Inlet.push_closed(inlet, time)))}

      _ ->
        {:noreply, state |> Ports.unsubscribe(&(&1.tag == tag)) |> Pump.pump()}
    end
  end

  def handle({:replace, index, module, opts}, state) do
    case Setup.replace(state, index, module, opts) do
      {:ok, state, actions} ->
        Stage.report(state, {:replaced, :ok})
        {:noreply, state |> Turn.act(state.core, actions, nil) |> Pump.pump()}

      {:error, error} ->
        Stage.report(state, {:replaced, {:error, error}})
        {:noreply, state}
    end
  end

  def handle(:describe, state) do
    Stage.report(state, {:description, Setup.describe(state)})
    {:noreply, state}
  end

  defp answered({:ok, reply, actions, state}, ref, _before) do
    Stage.report(state, {:answered, ref, {:ok, reply}, state.opts})
    {:noreply, state |> Turn.act(state.core, actions, nil) |> Pump.pump()}
  end

  defp answered({:error, error}, ref, state) do
    Stage.report(state, {:answered, ref, {:error, error}, state.opts})
    {:noreply, state}
  end

  defp tap(state, tag, {output, nil}, pid, counters) do
    {:ok, outlet} = Setup.find_outlet(state, output: output)
    sub = %{Subscriber.new(tag, pid, counters) | demand: :infinity}
    Ports.put_outlet(state, Outlet.subscribe(outlet, sub))
  end

  defp tap(state, tag, {_output, index}, pid, counters) do
    state = Probe.add(state, tag, index, pid, counters)
    ended = for {_, %{closing: time}} <- state.outlets, time != nil, do: time
    if ended != [], do: Probe.close(state, hd(ended))
    state
  end
end

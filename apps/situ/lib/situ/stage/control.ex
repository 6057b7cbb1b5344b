defmodule Situ.Stage.Control do
  @moduledoc false
  # Handles the requests of the pipeline's server to a stage. Each request is a step of its life cycle or a change while
  # it is running.
  alias Situ.{Clock, Error, Options}
  alias Situ.Component.Callback
  alias Situ.Operator.Chain
  alias Situ.Ports.{Input, Inputs, Output, Outputs, Posting}

  alias Situ.Stage.{
    Activation,
    Attachment,
    Emission,
    ErrorPolicy,
    Freeze,
    Loop,
    Memory,
    MessageRunner,
    Production,
    State
  }

  # Requests that may be answered before earlier messages: they neither start nor end anything.
  defguardp overtakes(request)
            when request in [:describe, :clock] or
                   (is_tuple(request) and
                      elem(request, 0) in [
                        :tap,
                        :untap,
                        :cut,
                        :replace,
                        :guarantee,
                        :lend,
                        :attach,
                        :detach,
                        :refresh
                      ])

  @doc "Handles requests that wait in the mailbox after other messages."
  @spec overtake(State.t()) :: State.t()
  def overtake(state) do
    receive do
      {:situ, request} when overtakes(request) ->
        {:noreply, state} = handle(request, state)
        overtake(state)
    after
      0 -> state
    end
  end

  @spec handle(term(), State.t()) :: {:noreply, State.t()} | {:stop, :normal, State.t()}
  def handle({:start, wiring}, state) do
    state = state |> State.wire(wiring) |> Memory.prepare() |> start() |> restored()
    State.report(state, :started)
    {:noreply, state}
  end

  def handle(:run, state) do
    Enum.each(state.inputs.by_tag, fn {_, input} -> Input.open(input) end)
    phase = if state.phase == :failed, do: :failed, else: :running
    {:noreply, %{state | phase: phase} |> Loop.turn() |> Loop.early()}
  end

  def handle({:ask, tag}, state) do
    with %{^tag => input} <- state.inputs.by_tag, do: Input.open(input)
    {:noreply, state}
  end

  def handle({:refresh, from}, state),
    do: {:noreply, outputs(state, &Output.refresh(&1, from), from)}

  # A checkpoint: this stage stands still until it is let go, or only tells what it remembers.
  def handle({:freeze, ref}, state) do
    state = state |> heard() |> Emission.settle_all()
    State.report(state, {:remembered, ref, Memory.take(state)})
    {state, actions} = Freeze.until(state, ref, &change/2)
    {:noreply, state |> act(actions) |> Loop.turn()}
  end

  def handle({:thaw, _ref}, state), do: {:noreply, state}

  def handle({:remember, ref}, state) do
    State.report(state, {:remembered, ref, Memory.take(state)})
    {:noreply, state}
  end

  # The pipeline knows of this source's end: what follows from its last messages is measured by it.
  def handle(:heard, state), do: {:noreply, state |> heard() |> Loop.turn()}

  # This source has handled all messages that were sent to it before.
  def handle(:settle, state) do
    State.report(state, :settled)
    {:noreply, state}
  end

  # A stage upstream failed at `time`: results for later times would rest on missing messages.
  def handle({:limit, time}, state) do
    final = min(state.source.final || time, time)
    {:noreply, %{state | source: %{state.source | final: final}}}
  end

  def handle({:stop, final}, state),
    do: {:noreply, state |> Production.stop(final) |> Loop.turn()}

  def handle(:stop_now, state), do: {:noreply, Production.stop_now(state)}

  # Stopped by hand, the server has looked whether things move.
  def handle(:looked, %{pace: %{continue: {:some, _term}}} = state) do
    taken = Inputs.taken(state.inputs)

    if state.pace.looked == taken,
      do:
        {:noreply,
         state |> ErrorPolicy.fail(endless(state)) |> MessageRunner.settled() |> Loop.turn()},
      else: {:noreply, %{state | pace: %{state.pace | looked: taken}}}
  end

  def handle(:looked, state), do: {:noreply, state}

  def handle({:finalize, time}, state) do
    state = state |> heard() |> Emission.settle_all() |> close(time) |> Emission.settle()
    Attachment.close_probes(state, time)
    State.report(state, :finalized)
    {:noreply, Loop.turn(state)}
  end

  # Subscribers from outside the pipeline still get what they have coming, at their own pace.
  def handle(:quit, state) do
    state = state |> heard() |> Emission.settle_all() |> close(state.source.final || 0)

    if Outputs.drained?(state.outputs),
      do: {:stop, :normal, state},
      else: {:noreply, %{state | pace: %{state.pace | quitting: true}}}
  end

  # The pipeline has failed elsewhere.
  def handle({:abandon, error}, state),
    do: {:noreply, state |> Emission.settle_all() |> ErrorPolicy.abandon(error) |> Loop.turn()}

  def handle({:tap, tap}, state) do
    state = Attachment.tap(state, tap)
    State.report(state, {:tapped, tap.tag})
    {:noreply, state}
  end

  # A consumer is to end before this stage does: it gets what waits for it, and the closing mark.
  def handle({:cut, tag, time}, state) do
    until = min(time, Clock.now(state.clock))
    outputs = Outputs.each(state.outputs, &Posting.release(&1, until))
    state = Emission.settle(heard(%{state | outputs: outputs}))
    {:noreply, Loop.turn(%{state | outputs: Outputs.cut(state.outputs, tag, time)})}
  end

  def handle({:untap, tag}, state),
    do: {:noreply, state |> Attachment.untap(tag) |> State.wake() |> Loop.turn()}

  def handle({:lend, tag, output, pid, counters, policy}, state) do
    {answer, state} = Attachment.lend(state, tag, output, pid, counters, policy)
    State.report(state, {:lent, tag, answer})
    {:noreply, Loop.turn(state)}
  end

  def handle({:attach, request, last, wiring}, state),
    do: answered(Attachment.input(state, request, last, wiring), wiring.tag, state)

  def handle({:detach, ref, request}, state),
    do: answered(Attachment.release(state, request), ref, state)

  def handle({:leave, input}, state),
    do: {:noreply, state |> Attachment.left(input) |> Loop.turn()}

  def handle({:fail, error}, state),
    do: {:noreply, state |> ErrorPolicy.fail(error) |> Loop.turn()}

  def handle(:clock, state), do: {:noreply, Loop.turn(state)}
  def handle({:peer, tag, pid}, state), do: {:noreply, State.rewire(state, tag, pid)}

  def handle({:peer_gone, tag, time}, state) do
    case state.inputs.by_tag do
      %{^tag => input} -> {:noreply, Loop.closing(state, input, time)}
      _ -> handle({:untap, tag}, state)
    end
  end

  def handle({:replace, _ref, _index, _module, _opts} = request, state) do
    {state, actions} = change(request, state)
    {:noreply, state |> act(actions) |> Loop.turn()}
  end

  def handle({:guarantee, tag, keep?}, state) do
    outputs = Outputs.each(state.outputs, &Output.guarantee(&1, tag, keep?))
    {:noreply, %{state | outputs: outputs, inputs: Inputs.guarantee(state.inputs, tag, keep?)}}
  end

  def handle(:describe, state) do
    State.report(state, {:description, state.callback && Callback.describe(state.callback)})
    {:noreply, state}
  end

  # Carried out; the component's actions are still to be done.
  defp change({:replace, ref, index, module, opts}, state) do
    case replace(state, index, module, opts) do
      {:ok, state, actions} ->
        State.report(state, {:replaced, ref, :ok})
        {state, actions}

      {:error, error} ->
        State.report(state, {:replaced, ref, {:error, error}})
        {state, []}
    end
  end

  defp change(request, state) do
    {:noreply, state} = handle(request, state)
    {state, []}
  end

  # The start time is the time of the first activation.
  defp start(%{callback: nil} = state), do: state

  defp start(state) do
    case Callback.call(state.callback, :handle_start, [state.context]) do
      {:ok, actions, core} -> state |> Activation.act(core, actions, Clock.now(state.clock))
      {:error, error} -> Activation.wrong(state, error)
    end
    |> Loop.turn()
  end

  defp restored(state) do
    with {:ok, state, ended} <- Memory.put(state),
         {:ok, state} <- Emission.run(state, ended, Clock.now(state.clock)) do
      state
    else
      {:error, error} -> ErrorPolicy.fail(state, error)
    end
  end

  defp heard(state), do: %{state | outputs: Outputs.wait(state.outputs, false)}

  defp endless(state) do
    path = State.head(state).path

    Error.new(:stuck, "#{path} did not come to the end of what it makes of one message",
      why: "the stop waited, and it has taken nothing else since",
      fix:
        "look for a gap in time that is filled at a small interval; raise stop_timeout: when it is just slow",
      meta: %{component: path}
    )
  end

  # At `time`; where later messages count, not before the last one.
  defp close(state, time) do
    whole? = State.final(state) >= State.never() - 1 and state.control != nil

    close = fn output ->
      Output.close(output, if(whole?, do: max(output.last_time || time, time), else: time))
    end

    %{state | outputs: Outputs.each(state.outputs, close)}
  end

  defp replace(%{chain: chain} = state, index, :operator, step) when chain != nil do
    plain = with {:keep, step} <- step, do: step
    vertices = List.update_at(state.vertices, index, &%{&1 | opts: plain})
    {:ok, %{state | vertices: vertices, chain: Chain.exchange(chain, index, step)}, []}
  end

  defp replace(state, 0, _module, {:keep, opts}) do
    with {:ok, callback} <- Callback.renew(state.callback, opts) do
      state = State.put_head(state, %{State.head(state) | opts: opts})
      {:ok, %{state | callback: callback}, []}
    end
  end

  defp replace(state, 0, module, opts) do
    context = State.context(state, Clock.now(state.clock))

    with {:ok, opts} <- Options.validate(opts, module.options()),
         {:ok, callback, actions} <- Callback.replace(state.callback, module, opts, context) do
      state = State.put_head(state, %{State.head(state) | module: module, opts: opts})
      {:ok, %{state | callback: callback}, actions}
    end
  end

  defp act(state, []), do: state

  defp act(state, actions),
    do: Activation.act(state, state.callback.core, actions, Clock.now(state.clock))

  defp answered({:ok, reply, state}, ref, _before) do
    State.report(state, {:answered, ref, {:ok, reply}, state.callback.opts})
    {:noreply, Loop.turn(state)}
  end

  defp answered({:error, error}, ref, state) do
    State.report(state, {:answered, ref, {:error, error}, state.callback && state.callback.opts})
    {:noreply, state}
  end

  defp outputs(state, fun, from) do
    outputs =
      Outputs.each(state.outputs, &if(Output.subscriber?(&1, from), do: fun.(&1), else: &1))

    %{state | outputs: outputs}
  end
end

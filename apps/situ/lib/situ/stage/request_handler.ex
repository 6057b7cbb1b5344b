defmodule Situ.Stage.RequestHandler do
  @moduledoc false
  # Handles the requests of the pipeline's server to a stage. Each request is a step of its life cycle or a change while
  # it is running.
  alias Situ.{Clock, Error, Options}
  alias Situ.Component.Callback
  alias Situ.Operator.Chain
  alias Situ.Ports.{Input, Inputs, Output, Outputs, PostingRules}

  alias Situ.Stage.{
    CallbackRunner,
    Subscriptions,
    ActionRunner,
    ErrorPolicy,
    Pause,
    Loop,
    Checkpoint,
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
  @spec handle_overtaking(State.t()) :: State.t()
  def handle_overtaking(state) do
    receive do
      {:situ, request} when overtakes(request) ->
        {:noreply, state} = handle_request(request, state)
        handle_overtaking(state)
    after
      0 -> state
    end
  end

  @spec handle_request(term(), State.t()) :: {:noreply, State.t()} | {:stop, :normal, State.t()}
  def handle_request({:start, wiring}, state) do
    state =
      state
      |> State.wire_neighbours(wiring)
      |> Checkpoint.prepare_outputs()
      |> start()
      |> restored()

    State.report_event(state, :started)
    {:noreply, state}
  end

  def handle_request(:run, state) do
    Enum.each(state.inputs.by_tag, fn {_, input} -> Input.request_first(input) end)
    phase = if state.phase == :failed, do: :failed, else: :running
    {:noreply, %{state | phase: phase} |> Loop.run_slice() |> Loop.handle_early()}
  end

  def handle_request({:ask, tag}, state) do
    with %{^tag => input} <- state.inputs.by_tag, do: Input.request_first(input)
    {:noreply, state}
  end

  def handle_request({:refresh, from}, state),
    do: {:noreply, outputs(state, &Output.refresh_subscriber(&1, from), from)}

  # For a checkpoint, this stage pauses until it is resumed, or only reports its state.
  def handle_request({:freeze, ref}, state) do
    state = state |> heard() |> ActionRunner.send_all_pending()
    State.report_event(state, {:remembered, ref, Checkpoint.take_snapshot(state)})
    {state, actions} = Pause.wait_for_thaw(state, ref, &change/2)
    {:noreply, state |> act(actions) |> Loop.run_slice()}
  end

  def handle_request({:thaw, _ref}, state), do: {:noreply, state}

  def handle_request({:remember, ref}, state) do
    State.report_event(state, {:remembered, ref, Checkpoint.take_snapshot(state)})
    {:noreply, state}
  end

  # The pipeline knows of this source's end, so later messages are measured by it.
  def handle_request(:heard, state), do: {:noreply, state |> heard() |> Loop.run_slice()}

  # This source has handled all messages that were sent to it before.
  def handle_request(:settle, state) do
    State.report_event(state, :settled)
    {:noreply, state}
  end

  # A stage upstream failed at `time`: results for later times would rest on missing messages.
  def handle_request({:limit, time}, state) do
    final = min(state.source.final || time, time)
    {:noreply, %{state | source: %{state.source | final: final}}}
  end

  def handle_request({:stop, final}, state),
    do: {:noreply, state |> Production.stop_source(final) |> Loop.run_slice()}

  def handle_request(:stop_now, state), do: {:noreply, Production.stop_now(state)}

  # Stopped by hand, the server has looked whether things move.
  def handle_request(:looked, %{pace: %{continue: {:some, _term}}} = state) do
    taken = Inputs.taken_count(state.inputs)

    if state.pace.looked == taken,
      do:
        {:noreply,
         state
         |> ErrorPolicy.fail_stage(endless(state))
         |> MessageRunner.settle_inputs()
         |> Loop.run_slice()},
      else: {:noreply, %{state | pace: %{state.pace | looked: taken}}}
  end

  def handle_request(:looked, state), do: {:noreply, state}

  def handle_request({:finalize, time}, state) do
    state =
      state
      |> heard()
      |> ActionRunner.send_all_pending()
      |> close(time)
      |> ActionRunner.send_pending()

    Subscriptions.close_probes(state, time)
    State.report_event(state, :finalized)
    {:noreply, Loop.run_slice(state)}
  end

  # Subscribers outside the pipeline still receive their remaining messages at their own pace.
  def handle_request(:quit, state) do
    state = state |> heard() |> ActionRunner.send_all_pending() |> close(state.source.final || 0)

    if Outputs.drained?(state.outputs),
      do: {:stop, :normal, state},
      else: {:noreply, %{state | pace: %{state.pace | quitting: true}}}
  end

  # The pipeline has failed elsewhere.
  def handle_request({:abandon, error}, state),
    do:
      {:noreply,
       state
       |> ActionRunner.send_all_pending()
       |> ErrorPolicy.abandon_consumers(error)
       |> Loop.run_slice()}

  def handle_request({:tap, tap}, state) do
    state = Subscriptions.add_tap(state, tap)
    State.report_event(state, {:tapped, tap.tag})
    {:noreply, state}
  end

  # A consumer is to end before this stage does: it gets what waits for it, and the closing mark.
  def handle_request({:cut, tag, time}, state) do
    until = min(time, Clock.now(state.clock))
    outputs = Outputs.map_outputs(state.outputs, &PostingRules.release_due(&1, until))
    state = ActionRunner.send_pending(heard(%{state | outputs: outputs}))

    {:noreply,
     Loop.run_slice(%{state | outputs: Outputs.cut_subscriber(state.outputs, tag, time)})}
  end

  def handle_request({:untap, tag}, state),
    do:
      {:noreply,
       state |> Subscriptions.remove_subscriber(tag) |> State.wake_source() |> Loop.run_slice()}

  def handle_request({:lend, tag, output, pid, counters, policy}, state) do
    {answer, state} = Subscriptions.lend_output(state, tag, output, pid, counters, policy)
    State.report_event(state, {:lent, tag, answer})
    {:noreply, Loop.run_slice(state)}
  end

  def handle_request({:attach, request, last, wiring}, state),
    do: answered(Subscriptions.attach_input(state, request, last, wiring), wiring.tag, state)

  def handle_request({:detach, ref, request}, state),
    do: answered(Subscriptions.detach_input(state, request), ref, state)

  def handle_request({:leave, input}, state),
    do: {:noreply, state |> Subscriptions.remove_input(input) |> Loop.run_slice()}

  def handle_request({:fail, error}, state),
    do: {:noreply, state |> ErrorPolicy.fail_stage(error) |> Loop.run_slice()}

  def handle_request(:clock, state), do: {:noreply, Loop.run_slice(state)}

  def handle_request({:peer, tag, pid}, state),
    do: {:noreply, State.replace_neighbour(state, tag, pid)}

  def handle_request({:peer_gone, tag, time}, state) do
    case state.inputs.by_tag do
      %{^tag => input} -> {:noreply, Loop.handle_closing(state, input, time)}
      _ -> handle_request({:untap, tag}, state)
    end
  end

  def handle_request({:replace, _ref, _index, _module, _opts} = request, state) do
    {state, actions} = change(request, state)
    {:noreply, state |> act(actions) |> Loop.run_slice()}
  end

  def handle_request({:guarantee, tag, keep?}, state) do
    outputs = Outputs.map_outputs(state.outputs, &Output.put_guarantee(&1, tag, keep?))

    {:noreply,
     %{state | outputs: outputs, inputs: Inputs.put_guarantee(state.inputs, tag, keep?)}}
  end

  def handle_request(:describe, state) do
    State.report_event(
      state,
      {:description, state.callback && Callback.describe_state(state.callback)}
    )

    {:noreply, state}
  end

  # Carried out; the component's actions are still to be done.
  defp change({:replace, ref, index, module, opts}, state) do
    case replace(state, index, module, opts) do
      {:ok, state, actions} ->
        State.report_event(state, {:replaced, ref, :ok})
        {state, actions}

      {:error, error} ->
        State.report_event(state, {:replaced, ref, {:error, error}})
        {state, []}
    end
  end

  defp change(request, state) do
    {:noreply, state} = handle_request(request, state)
    {state, []}
  end

  # The start time is the time of the first activation.
  defp start(%{callback: nil} = state), do: state

  defp start(state) do
    case Callback.call_callback(state.callback, :handle_start, [state.context]) do
      {:ok, actions, core} ->
        state |> CallbackRunner.apply_result(core, actions, Clock.now(state.clock))

      {:error, error} ->
        CallbackRunner.handle_error(state, error)
    end
    |> Loop.run_slice()
  end

  defp restored(state) do
    with {:ok, state, ended} <- Checkpoint.restore_state(state),
         {:ok, state} <- ActionRunner.apply_actions(state, ended, Clock.now(state.clock)) do
      state
    else
      {:error, error} -> ErrorPolicy.fail_stage(state, error)
    end
  end

  defp heard(state), do: %{state | outputs: Outputs.set_waiting(state.outputs, false)}

  defp endless(state) do
    path = State.head_vertex(state).path

    Error.new(:stuck, "#{path} did not finish handling one message",
      why: "the stop waited, and it has taken nothing else since",
      fix:
        "look for a gap in time that is filled at a small interval; raise stop_timeout: when it is just slow",
      meta: %{component: path}
    )
  end

  # At `time`; where later messages count, not before the last one.
  defp close(state, time) do
    whole? = State.final_time(state) >= State.no_final_time() - 1 and state.control != nil

    close = fn output ->
      Output.close(output, if(whole?, do: max(output.last_time || time, time), else: time))
    end

    %{state | outputs: Outputs.map_outputs(state.outputs, close)}
  end

  defp replace(%{chain: chain} = state, index, :operator, step) when chain != nil do
    plain = with {:keep, step} <- step, do: step
    vertices = List.update_at(state.vertices, index, &%{&1 | opts: plain})
    {:ok, %{state | vertices: vertices, chain: Chain.replace_step(chain, index, step)}, []}
  end

  defp replace(state, 0, _module, {:keep, opts}) do
    with {:ok, callback} <- Callback.replace_functions(state.callback, opts) do
      state = State.put_head(state, %{State.head_vertex(state) | opts: opts})
      {:ok, %{state | callback: callback}, []}
    end
  end

  defp replace(state, 0, module, opts) do
    context = State.context_at(state, Clock.now(state.clock))

    with {:ok, opts} <- Options.validate(opts, module.options()),
         {:ok, callback, actions} <-
           Callback.replace_component(state.callback, module, opts, context) do
      state = State.put_head(state, %{State.head_vertex(state) | module: module, opts: opts})
      {:ok, %{state | callback: callback}, actions}
    end
  end

  defp act(state, []), do: state

  defp act(state, actions),
    do: CallbackRunner.apply_result(state, state.callback.core, actions, Clock.now(state.clock))

  defp answered({:ok, reply, state}, ref, _before) do
    State.report_event(state, {:answered, ref, {:ok, reply}, state.callback.opts})
    {:noreply, Loop.run_slice(state)}
  end

  defp answered({:error, error}, ref, state) do
    State.report_event(
      state,
      {:answered, ref, {:error, error}, state.callback && state.callback.opts}
    )

    {:noreply, state}
  end

  defp outputs(state, fun, from) do
    outputs =
      Outputs.map_outputs(
        state.outputs,
        &if(Output.has_subscriber?(&1, from), do: fun.(&1), else: &1)
      )

    %{state | outputs: outputs}
  end
end

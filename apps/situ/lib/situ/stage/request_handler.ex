defmodule Situ.Stage.RequestHandler do
  @moduledoc false
  # Handles the requests of the pipeline's server to a stage. Each request is a step of its life cycle or a change while
  # it is running.
  alias Situ.{Clock, Error}
  alias Situ.Component.Callback
  alias Situ.Ports.{Address, Input, Inputs, Output, Outputs, PostingRules, Subscriber}

  alias Situ.Stage.{
    ActionRunner,
    CallbackRunner,
    Checkpoint,
    ErrorPolicy,
    Loop,
    Pause,
    Production,
    Replacement,
    State,
    Step,
    Subscriptions
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
      |> State.update_step(0, &start_component/1)
      |> Loop.settle()
      |> restore_state()

    report(state, :started)
    {:noreply, state}
  end

  def handle_request(:run, state) do
    for step <- State.list_steps(state),
        {_, input} <- step.inputs.by_tag,
        do: Input.request_first(input)

    state =
      State.map_steps(state, &if(&1.phase == :failed, do: &1, else: %{&1 | phase: :running}))

    {:noreply, state |> Loop.run_slice() |> Loop.handle_early()}
  end

  def handle_request({:ask, tag}, state) do
    with {_i, input} <- State.find_input(state, tag), do: Input.request_first(input)
    {:noreply, state}
  end

  def handle_request({:refresh, from}, state) do
    case State.update_outputs(state, &Outputs.refresh_subscriber(&1, from)) do
      {:ok, state} -> {:noreply, state}
      :error -> {:noreply, state}
    end
  end

  # For a checkpoint, this stage pauses until it is resumed, or only reports its state.
  def handle_request({:freeze, ref}, state) do
    state = prepare_pause(state, ref)
    {state, actions} = Pause.wait_for_thaw(state, ref, &change/2)
    {:noreply, resume_after_pause(state, actions)}
  end

  def handle_request({:thaw, _ref}, state), do: {:noreply, state}

  def handle_request({:remember, ref}, state) do
    report(state, {:remembered, ref, Checkpoint.take_snapshot(state)})
    {:noreply, state}
  end

  # The pipeline knows of this source's end, so later messages are measured by it.
  def handle_request(:heard, state),
    do: {:noreply, state |> release_withheld() |> Loop.run_slice()}

  # This source has handled all messages that were sent to it before.
  def handle_request(:settle, state) do
    report(state, :settled)
    {:noreply, state}
  end

  # A stage upstream failed at `time`: results for later times would rest on missing messages.
  def handle_request({:limit, time}, state) do
    limit = fn %{source: source} = step ->
      %{step | source: %{source | final: min(source.final || time, time)}}
    end

    {:noreply, State.map_steps(state, limit)}
  end

  def handle_request({:stop, final}, state),
    do:
      {:noreply,
       state |> State.update_step(0, &Production.stop_source(&1, final)) |> Loop.run_slice()}

  def handle_request(:stop_now, state),
    do: {:noreply, State.update_step(state, 0, &Production.stop_now/1)}

  # The server has checked a pipeline that is being stopped for progress.
  def handle_request(:looked, state),
    do: {:noreply, state |> State.update_step(0, &check_progress/1) |> Loop.settle()}

  def handle_request({:finalize, time}, state) do
    state = state |> release_withheld() |> close_outputs(time)
    for step <- State.list_steps(state), do: Subscriptions.close_probes(step, time)
    report(state, :finalized)
    {:noreply, Loop.run_slice(state)}
  end

  # Subscribers outside the pipeline still receive their remaining messages at their own pace.
  def handle_request(:quit, %{steps: steps} = state) do
    state = state |> release_withheld() |> close_outputs(elem(steps, 0).source.final || 0)
    stop_if_over(%{state | quitting: true})
  end

  # The pipeline has failed elsewhere.
  def handle_request({:abandon, error}, state) do
    state = Loop.run_waiting(state)
    state = State.map_steps(state, &ErrorPolicy.abandon_consumers(&1, error))
    {:noreply, Loop.run_slice(state)}
  end

  def handle_request({:tap, tap}, state) do
    state = Subscriptions.add_tap(state, tap)
    report(state, {:tapped, tap.tag})
    {:noreply, state}
  end

  # A consumer is to end before this stage does: it receives what waits for it, and the closing mark.
  def handle_request({:cut, tag, time}, state) do
    until = min(time, Clock.now(state.host.clock))
    release = &Outputs.map_outputs(&1, fn output -> PostingRules.release_due(output, until) end)
    state = state |> State.map_outputs(release) |> release_withheld() |> Loop.settle()
    state = State.map_outputs(state, &Outputs.cut_subscriber(&1, tag, time))
    {:noreply, Loop.run_slice(state)}
  end

  def handle_request({:untap, tag}, state) do
    state = state |> Subscriptions.remove_subscriber(tag) |> State.map_steps(&Step.wake_source/1)
    {:noreply, Loop.run_slice(state)}
  end

  def handle_request({:lend, tag, output, pid, counters, policy}, state) do
    {answer, state} =
      Subscriptions.lend_output(state, output, Subscriber.new(tag, pid, counters, policy))

    report(state, {:lent, tag, answer})
    {:noreply, Loop.run_slice(state)}
  end

  def handle_request({:attach, request, last, wiring}, state),
    do:
      state
      |> Subscriptions.attach_input(request, last, wiring)
      |> report_answer(wiring.tag, state)

  def handle_request({:detach, ref, request}, state),
    do: state |> Subscriptions.detach_input(request) |> report_answer(ref, state)

  def handle_request({:leave, input}, state),
    do:
      {:noreply,
       state |> State.update_step(0, &Subscriptions.remove_input(&1, input)) |> Loop.run_slice()}

  def handle_request({:fail, error}, state),
    do:
      {:noreply, state |> State.map_steps(&ErrorPolicy.fail_step(&1, error)) |> Loop.run_slice()}

  def handle_request(:clock, state), do: state |> Loop.run_slice() |> stop_if_over()

  # A neighbour was restarted, but the connection has ended here: a consumer needs only the closing mark, and a producer
  # must not wait for demand. Before its start, a stage knows no connections.
  def handle_request({:peer, tag, pid, closing}, %{host: %{clock: clock}} = state) do
    known? = State.find_input(state, tag) || State.find_subscriber(state, tag)

    cond do
      known? || clock == nil -> :ok
      closing -> Subscriber.send_close(Subscriber.new(tag, pid, nil), closing)
      true -> Address.acknowledge_end(pid, tag)
    end

    {:noreply, State.replace_neighbour(state, tag, pid)}
  end

  def handle_request({:peer_gone, tag, time}, state) do
    case State.find_input(state, tag) do
      nil -> handle_request({:untap, tag}, state)
      found -> {:noreply, Loop.handle_closing(state, found, time)}
    end
  end

  def handle_request({:replace, _ref, _index, _module, _opts} = request, state) do
    {state, actions} = change(request, state)
    {:noreply, state |> apply_actions(actions) |> Loop.run_slice()}
  end

  def handle_request({:guarantee, tag, keep?}, state) do
    put = fn step ->
      outputs = Outputs.map_tagged(step.outputs, tag, &Subscriber.put_guarantee(&1, keep?))
      %{step | outputs: outputs, inputs: Inputs.put_guarantee(step.inputs, tag, keep?)}
    end

    {:noreply, State.map_steps(state, put)}
  end

  def handle_request(:describe, %{steps: steps} = state) do
    worker = elem(steps, 0).worker
    text = if is_struct(worker, Callback), do: Callback.describe_state(worker)
    report(state, {:description, text})
    {:noreply, state}
  end

  @doc "Sends everything that waits in the stage and reports its state for the checkpoint `ref`."
  @spec prepare_pause(State.t(), term()) :: State.t()
  def prepare_pause(state, ref) do
    state = state |> release_withheld() |> Loop.run_waiting()
    report(state, {:remembered, ref, Checkpoint.take_snapshot(state)})
    state
  end

  @doc "Applies the actions of the changes during a pause, and continues."
  @spec resume_after_pause(State.t(), [Situ.Component.action()]) :: State.t()
  def resume_after_pause(state, actions), do: state |> apply_actions(actions) |> Loop.run_slice()

  defp report(%{steps: steps}, event), do: Step.report_event(elem(steps, 0), event)

  @doc "Performs a request; the component's actions that it returns are still to be applied."
  @spec change(term(), State.t()) :: {State.t(), [Situ.Component.action()]}
  def change({:replace, ref, index, module, opts}, state) do
    {i, step} = State.step_at(state, index)

    case Replacement.replace(step, index, module, opts) do
      {:ok, step, actions} ->
        report(state, {:replaced, ref, :ok})
        {State.put_step(state, i, step), actions}

      {:error, error} ->
        report(state, {:replaced, ref, {:error, error}})
        {state, []}
    end
  end

  def change(request, state) do
    {:noreply, state} = handle_request(request, state)
    {state, []}
  end

  # The start time is the time of the first activation.
  defp start_component(%{worker: %Callback{} = worker} = step) do
    case Callback.call_callback(worker, :handle_start, [step.context]) do
      {:ok, actions, core} -> CallbackRunner.apply_result(step, core, actions)
      {:error, error} -> CallbackRunner.handle_error(step, error)
    end
  end

  defp start_component(step), do: step

  defp restore_state(state) do
    with {:ok, state, ended} <- Checkpoint.restore_state(state),
         {:ok, step} <- ActionRunner.apply_actions(elem(state.steps, 0), ended) do
      State.put_step(state, 0, step)
    else
      {:error, error} -> State.update_step(state, 0, &ErrorPolicy.fail_step(&1, error))
    end
  end

  defp release_withheld(state), do: State.map_outputs(state, &Outputs.set_withheld(&1, false))

  defp check_progress(%{work: %{continue: {:some, _term}} = work} = step) do
    taken = Inputs.taken_count(step.inputs)

    if work.looked == taken,
      do: ErrorPolicy.fail_step(step, endless(step)),
      else: %{step | work: %{work | looked: taken}}
  end

  defp check_progress(step), do: step

  defp endless(step) do
    path = Step.head_vertex(step).path

    Error.new(:stuck, "#{path} did not finish handling one message",
      why: "the stop waited, and it has taken nothing else since",
      fix:
        "look for a gap in time that is filled at a small interval; raise stop_timeout: when it is just slow",
      meta: %{component: path}
    )
  end

  # Closes the outputs at `time`, after everything that waits before them. Steps that get their messages from the first
  # one close after it, also after messages that wait for their time. If later messages count, the outputs close no
  # earlier than their last message.
  defp close_outputs(state, time),
    do:
      state |> Loop.run_waiting() |> State.update_step(0, &close_step(&1, time)) |> Loop.settle()

  defp close_step(step, time) do
    all_count? = Step.final_time(step) >= Step.no_final_time() - 1 and step.host.control != nil

    Step.map_outputs(step, fn output ->
      Output.close(output, if(all_count?, do: max(output.last_time || time, time), else: time))
    end)
  end

  defp stop_if_over(state),
    do: if(State.over?(state), do: {:stop, :normal, state}, else: {:noreply, state})

  defp apply_actions(state, []), do: state

  defp apply_actions(state, actions) do
    State.update_step(state, 0, fn step ->
      step = Step.read_clock(step)
      CallbackRunner.apply_result(step, step.worker.core, actions)
    end)
  end

  defp report_answer({:ok, reply, state}, ref, _before) do
    report(state, {:answered, ref, {:ok, reply}, elem(state.steps, 0).worker.opts})
    {:noreply, Loop.run_slice(state)}
  end

  defp report_answer({:error, error}, ref, %{steps: steps} = state) do
    opts = with(%Callback{opts: opts} <- elem(steps, 0).worker, do: opts, else: (_ -> nil))
    report(state, {:answered, ref, {:error, error}, opts})
    {:noreply, state}
  end
end

defmodule Situ.Stage.Loop do
  @moduledoc false
  # Runs a time slice of a stage: the most downstream step that has something to take and room for its results comes
  # first, until there is none or the slice is over. Then the outputs are flushed, and the stage takes the next entry of
  # its mailbox. While another slice is scheduled, new messages only queue.
  alias Situ.Clock.Timers
  alias Situ.Component.Callback
  alias Situ.Delivery.Batch
  alias Situ.Ports.{Input, Inputs, Outputs}
  alias Situ.Stage.{CallbackRunner, State, Step, StepRunner, Subscriptions}

  @compile {:inline, last: 1, resume_demand: 1, schedule: 1, enlarge_heap: 2}

  @slice_ns 5_000_000
  @flush_ns 200_000
  @large_batch 64
  @large_heap_words 32_768

  @doc "Handles batches at an input of step `i`, or `{:fresh, messages}`: all that a lossy input's producer held."
  @spec handle_batches(State.t(), {non_neg_integer(), Input.t()}, [Batch.t()] | {:fresh, list()}) ::
          State.t()
  def handle_batches(state, {i, input}, {:fresh, messages}),
    do: run_input(state, i, Input.push_refreshed(input, messages))

  def handle_batches(state, {i, input}, batches),
    do: run_input(state, i, Input.push(input, batches))

  defp run_input(%{steps: {step}} = state, 0, input),
    do: run_slice(state, Step.put_input(step, input))

  defp run_input(state, i, input), do: state |> State.put_input(i, input) |> run_slice()

  @doc "Handles new demand of a consumer."
  @spec handle_demand(State.t()) :: State.t()
  # Everything was settled when the last slice ended: without anything to take or to publish, there is nothing to do.
  def handle_demand(%{steps: {%{inputs: %{touched: []}} = step}} = state),
    do: if(StepRunner.has_work?(step), do: run_slice(state), else: state)

  def handle_demand(state), do: run_slice(state)

  @doc "Closes the input after its waiting messages."
  @spec handle_closing(State.t(), {non_neg_integer(), Input.t()}, Situ.Time.t()) :: State.t()
  def handle_closing(state, {i, input}, time),
    do: state |> State.put_input(i, Input.push_closed(input, time)) |> run_slice()

  @doc "Handles a plain message for the component of the stage."
  @spec handle_plain_message(State.t(), term()) :: State.t()
  # A neighbour that started sooner may have closed already, and a producer from outside may have failed. Their messages
  # wait until this stage runs, so that `on_error` applies to their errors.
  def handle_plain_message(%{steps: steps} = state, message) do
    case elem(steps, 0) do
      %{phase: :starting} ->
        keep_early(state, message)

      %{phase: :running, worker: %Callback{}} = step ->
        step = Step.wake_source(step)
        step = CallbackRunner.call_callback(step, :handle_info, [message])
        state |> State.put_step(0, step) |> run_slice()

      _failed_or_chain ->
        state
    end
  end

  @doc "Keeps a message from outside until the stage is running."
  @spec keep_early(State.t(), term()) :: State.t()
  def keep_early(%{early: early} = state, message), do: %{state | early: [message | early]}

  @doc "Handles, in order, the messages from outside that arrived before the stage was running."
  @spec handle_early(State.t()) :: State.t()
  def handle_early(%{early: early} = state) do
    early
    |> Enum.reverse()
    |> Enum.reduce(%{state | early: []}, fn
      {:"$gen_producer", from, request}, state ->
        state |> Subscriptions.handle_consumer_request(from, request) |> run_slice()

      message, state ->
        handle_plain_message(state, message)
    end)
  end

  @doc "Handles a request of another process to the component (`from` is `nil` for a cast)."
  @spec handle_request(State.t(), term(), GenServer.from() | nil) :: State.t()
  def handle_request(state, request, from) do
    handle = &CallbackRunner.handle_request(Step.wake_source(&1), request, from)
    state |> State.update_step(0, handle) |> run_slice()
  end

  @doc "Runs due timers and releases messages whose time has come."
  @spec handle_alarm(State.t()) :: State.t()
  # It is set again when the stage runs.
  def handle_alarm(%{steps: steps} = state) when elem(steps, 0).phase == :starting,
    do: State.map_steps(state, &%{&1 | timers: Timers.clear_alarm(&1.timers)})

  def handle_alarm(state), do: state |> State.map_steps(&StepRunner.run_due/1) |> run_slice()

  @doc "Runs the scheduled time slice."
  @spec run_scheduled_slice(State.t()) :: State.t()
  def run_scheduled_slice(state), do: run_slice(%{state | scheduled: false})

  @doc "Runs a time slice; if one is already scheduled, only sends pending messages."
  @spec run_slice(State.t()) :: State.t()
  def run_slice(%{steps: {step}} = state), do: run_slice(state, step)
  def run_slice(%{scheduled: true} = state), do: settle(state)
  def run_slice(%{steps: steps} = state) when elem(steps, 0).phase == :starting, do: settle(state)

  def run_slice(state) do
    start = State.monotonic_time(state)
    run_steps(state, last(state), {0, start, start + @flush_ns, start + @slice_ns})
  end

  # Most stages have one step.
  defp run_slice(%{scheduled: scheduled?} = state, step)
       when scheduled? or step.phase == :starting,
       do: %{state | steps: {StepRunner.settle(step)}}

  defp run_slice(state, step) do
    start = Step.monotonic_time(step)
    {outcome, step} = run_alone(step, start, start + @flush_ns, start + @slice_ns)
    state = enlarge_heap(state, step)
    state = %{state | steps: {StepRunner.settle(step)}}
    if outcome == :idle, do: state, else: schedule(state)
  end

  defp run_alone(step, now, flush, deadline) do
    step = resume_demand(step)

    if StepRunner.has_work?(step) do
      room = Outputs.available_room(step.outputs)

      case StepRunner.run_next(step, {room, now, deadline}) do
        {:more, step} -> run_on(step, max(now, step.work.time), flush, deadline)
        ended -> ended
      end
    else
      {:idle, step}
    end
  end

  defp run_on(step, now, _flush, deadline) when now > deadline, do: {:yield, step}

  defp run_on(step, now, flush, deadline) when now > flush,
    do: step |> StepRunner.settle() |> run_alone(now, now + @flush_ns, deadline)

  defp run_on(step, now, flush, deadline), do: run_alone(step, now, flush, deadline)

  defp last(%{steps: steps}), do: tuple_size(steps) - 1

  # Step `i` and those before it may have something to do, down to step `first`.
  defp run_steps(state, i, {first, _now, _flush, _deadline}) when i < first,
    do: if(first == 0, do: settle(state), else: schedule_slice(state))

  defp run_steps(%{steps: steps} = state, i, {_first, now, _flush, deadline} = times) do
    step = resume_demand(elem(steps, i))
    {outcome, step} = StepRunner.run_next(step, {available_room(state, step), now, deadline})
    {passed?, state} = state |> State.put_step(i, step) |> pass_on(i)

    case outcome do
      :idle when not passed? -> run_steps(state, i - 1, times)
      # The messages of this step pass through the steps after it before the stage looks into its mailbox.
      :yield -> run_steps(state, last(state), put_elem(times, 0, i + 1))
      _more -> run_more(state, max(now, step.work.time), times)
    end
  end

  defp run_more(state, now, {_first, _before, _flush, deadline}) when now > deadline,
    do: schedule_slice(state)

  defp run_more(state, now, {first, _before, flush, deadline}) when now > flush,
    do: state |> settle() |> run_steps(last(state), {first, now, now + @flush_ns, deadline})

  defp run_more(state, now, times),
    do: run_steps(state, last(state), put_elem(times, 1, now))

  # A pipeline that ends does not wait for a paused stage to resume.
  defp resume_demand(%{outputs: %{demand: :accumulate}} = step),
    do:
      if(Step.final_time(step) == Step.no_final_time(),
        do: step,
        else: Step.set_demand(step, :forward)
      )

  defp resume_demand(%{outputs: %{dispatcher: %{discards?: false}}} = step),
    do:
      if(Step.final_time(step) == Step.no_final_time(),
        do: step,
        else: %{step | outputs: Outputs.discard_unclaimed(step.outputs)}
      )

  defp resume_demand(step), do: step

  # Returns how many messages a step may post: none while those before wait for a step after it.
  defp available_room(state, step) do
    room = Outputs.available_room(step.outputs)

    for %{demand: :local, tag: tag} <- Outputs.list_subscribers(step.outputs), reduce: room do
      room -> min(room, local_room(state, elem(state.steps, state.links[tag])))
    end
  end

  defp local_room(state, step) do
    if Inputs.earliest_input(step.inputs) != nil,
      do: 0,
      else: min(step.work.slice, available_room(state, step))
  end

  # Passes what step `i` has posted on to the steps after it; returns whether there was anything.
  defp pass_on(%{steps: steps, links: links} = state, i) do
    step = elem(steps, i)
    {taken, outputs} = step.outputs |> Outputs.flush(step.context.now) |> Outputs.take_local()
    state = State.put_step(state, i, %{step | outputs: outputs})

    state =
      Enum.reduce(taken, state, fn {tag, batches}, state ->
        State.update_step(state, links[tag], &push_local(&1, tag, batches))
      end)

    {taken != [], state}
  end

  defp push_local(%{inputs: %{by_tag: by_tag}} = step, tag, batches) do
    case by_tag do
      %{^tag => input} -> Step.put_input(step, Input.push(input, batches))
      _has_closed -> step
    end
  end

  @doc "Sends pending messages, publishes counts and sets alarms."
  @spec settle(State.t()) :: State.t()
  def settle(%{steps: {step}} = state), do: %{state | steps: {StepRunner.settle(step)}}
  def settle(state), do: settle(state, last(state), false)

  # Downstream first: an input is acknowledged when everything made of it has been sent.
  defp settle(state, -1, passed?),
    do: if(passed?, do: schedule(state), else: state)

  defp settle(%{steps: steps} = state, i, passed?) do
    step = elem(steps, i)

    {also?, state} =
      state
      |> enlarge_heap(step)
      |> State.put_step(i, StepRunner.settle(step, State.may_acknowledge?(state)))
      |> pass_on(i)

    settle(state, i - 1, passed? or also?)
  end

  defp schedule_slice(state), do: state |> settle() |> schedule()

  # Asks for another time slice after the current mailbox, or after the other stages of the process.
  defp schedule(%{scheduled: true} = state), do: state

  defp schedule(state) do
    Step.send_to_stage(state.host, :situ_turn)
    %{state | scheduled: true}
  end

  # Enlarges the heap, once, of a stage that handles many messages in one slice. Otherwise successive garbage
  # collections would copy the messages again and again: CPU per message fell from 0.60 to 0.51 us in a chain of one,
  # and from 1.77 to 1.52 us in a join. Only busy stages get the 256 KiB, because a parallel with processes may have
  # thousands of idle ones. VM flags would change the heaps of the host application too.
  defp enlarge_heap(%{large_heap: false} = state, %{work: %{spent: {n, _ns}}})
       when n >= @large_batch do
    Process.flag(:min_heap_size, @large_heap_words)
    %{state | large_heap: true}
  end

  defp enlarge_heap(state, _step), do: state

  @doc "Runs everything that waits in the stage, regardless of time and demand, before it closes or pauses."
  @spec run_waiting(State.t()) :: State.t()
  def run_waiting(%{links: links} = state) when links == %{}, do: settle(state)
  def run_waiting(state), do: run_waiting(state, 0)

  defp run_waiting(%{steps: steps} = state, i) when i == tuple_size(steps), do: settle(state)

  defp run_waiting(%{steps: steps} = state, i) do
    step = elem(steps, i)
    {_passed?, state} = state |> State.put_step(i, run_local(step)) |> pass_on(i)
    run_waiting(state, i + 1)
  end

  # Only the inputs that get their messages from this process.
  defp run_local(step) do
    case Inputs.earliest_input(step.inputs) do
      %{producer: nil} ->
        {_outcome, step} = StepRunner.run_next(step, {:infinity, step.work.time, :never})
        run_local(step)

      _none_or_another_process ->
        step
    end
  end
end

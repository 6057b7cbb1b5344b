defmodule Situ.Stage.StepRunner do
  @moduledoc false
  # Runs one step of a stage: takes messages from its inputs, runs them through its component or its operators (several
  # together in BatchRunner), and counts them. Nothing is sent before `settle/2`.
  alias Situ.Clock.Timers
  alias Situ.Component.Callback
  alias Situ.Operator.Chain
  alias Situ.Ports.{Input, Inputs, Output, Outputs}
  alias Situ.Stage.{BatchRunner, CallbackRunner, Production, Step, Work}

  @compile {:inline,
            takes_batches?: 2, handle_message: 3, end_linger: 1, report_closings: 1, release: 1}

  @chain_ns 1_000_000

  @typedoc "The step has nothing to do, may have more, or lets the stage look into its mailbox first."
  @type outcome :: :idle | :more | :yield
  @typep limits ::
           {room :: integer() | :infinity, started :: integer(), deadline :: integer() | :never}

  @doc """
  Returns whether the step has something to take or may produce something. It may still lack room for the results.
  """
  @spec has_work?(Step.t()) :: boolean()
  def has_work?(%{phase: :failed}), do: true
  def has_work?(%{source: %{kind: :pull}}), do: true

  def has_work?(%{inputs: inputs, work: work}),
    do: work.continue != :none or Inputs.earliest_input(inputs) != nil

  @doc """
  Runs the next messages of the step, as far as there is `room` in its outputs. It is `started` now and runs no longer
  than the `deadline`, both monotonic times (ns).
  """
  @spec run_next(Step.t(), limits()) :: {outcome(), Step.t()}
  def run_next(%{phase: :failed} = step, _limits), do: {:idle, discard_inputs(step)}
  def run_next(step, {room, _started, _deadline}) when room < 1, do: {:idle, step}

  # The component has more output for the messages it has received.
  def run_next(%{work: %{continue: {:some, term}} = work} = step, _limits) do
    step = %{step | work: %{work | continue: :none}}
    {:more, CallbackRunner.call_callback(step, :handle_info, [{:continue, term}])}
  end

  def run_next(%{worker: worker, work: work} = step, {room, started, _deadline} = limits) do
    case Inputs.earliest_input(step.inputs) do
      nil ->
        Production.produce_messages(step, room)

      %{lossy: nil} = input ->
        if takes_batches?(worker, input) and work.singly == 0,
          do: take_batch(step, input, limits),
          else: run_singly(step, limits)

      input ->
        run_newest(step, input, started)
    end
  end

  defp takes_batches?(%Chain{}, _input), do: true
  defp takes_batches?(%Callback{batch: batch?}, input), do: batch? and input.check == :off

  # A chain takes as many messages as there is room for, since it looks at the time itself. A component with
  # `handle_messages/4` takes as many as it handles in about a millisecond.
  defp take_batch(%{worker: worker} = step, input, {room, started, deadline}) do
    chain? = is_struct(worker, Chain)

    case Input.take_batch(input, if(chain?, do: room, else: min(room, step.work.slice))) do
      {nil, input} ->
        {:more, take_closing(step, input)}

      {batch, input} ->
        deadline = if chain?, do: min(deadline, started + @chain_ns), else: deadline
        BatchRunner.run_batch(step, input, batch, {started, deadline})
    end
  end

  # Other components take one message at a time, the earliest among their inputs first.
  defp run_singly(step, {room, started, deadline}) do
    step = Step.read_clock(step)
    {outcome, step, n} = run_singly(step, min(room, step.work.slice), deadline, 0)
    %{work: work} = step = Step.count_handled(step, n, max(n, 1), started)
    {outcome, if(work.singly > 0, do: count_singly(step, n), else: step)}
  end

  defp count_singly(%{work: work} = step, n),
    do: %{step | work: %{work | singly: max(work.singly - n, 0)}}

  defp run_singly(step, most, deadline, n) do
    case Inputs.earliest_input(step.inputs) do
      %{lossy: nil} = input when n < most ->
        case Input.pop(input, 0) do
          # The results of the messages before it leave the stage first.
          {entry, _input} when is_tuple(entry) and n > 0 -> {:more, step, n}
          {entry, input} -> run_single(step, {input, entry}, most, deadline, n)
        end

      _none_or_lossy_or_enough ->
        {:more, step, n}
    end
  end

  defp run_single(step, {input, entry}, most, deadline, n) do
    step = step |> Step.put_input(input) |> handle_entry(input, entry)

    cond do
      is_tuple(entry) -> {:more, step, n}
      step.phase == :failed or step.work.continue != :none -> {:more, step, n + 1}
      past?(step, deadline) -> {:yield, step, n + 1}
      Outputs.pending_count(step.outputs) >= most -> {:more, step, n + 1}
      true -> run_singly(step, most, deadline, n + 1)
    end
  end

  defp past?(step, deadline), do: Step.monotonic_time(step) > deadline

  # Under a lossy policy, messages in the mailbox join the queue before the next message is taken.
  defp run_newest(step, input, started) do
    case Input.ensure_fresh(input) do
      {:wait, input} ->
        {:more, Step.put_input(step, input)}

      {:ok, input} ->
        step = Step.read_clock(step)
        {entry, input} = Input.pop(input, step.context.now)
        {:yield, step |> Step.put_input(input) |> run_entry(input, entry, started)}
    end
  end

  defp run_entry(%{worker: %Chain{}} = step, input, entry, started) when is_struct(entry),
    do: step |> BatchRunner.run_batch(input, [entry], {started, :never}) |> elem(1)

  defp run_entry(step, input, entry, started) do
    step = handle_entry(step, input, entry)
    Step.count_handled(step, if(is_struct(entry), do: 1, else: 0), 1, started)
  end

  defp handle_entry(step, _input, nil), do: step
  defp handle_entry(step, input, {:closed, time}), do: close_input(step, input, time)

  defp handle_entry(step, input, %{originating_time: time} = message) do
    if time > Step.final_time(step) do
      Step.put_input(step, Input.drop_taken(input, 1))
    else
      step = handle_message(step, input, message)
      # The component may have paused or detached the input.
      input = Map.get(step.inputs.by_tag, input.tag, input)
      Step.put_input(step, Input.count_handled(input, 1, time, step.context.now))
    end
  end

  defp handle_message(step, %{check: :off} = input, message),
    do: call_component(step, input, message)

  defp handle_message(step, input, message) do
    case Input.check_type(input, message, step.worker.path) do
      {:ok, input} -> step |> Step.put_input(input) |> call_component(input, message)
      {:error, error} -> handle_error(step, error, input, message)
    end
  end

  defp call_component(step, input, message) do
    with {:ok, actions, core} <-
           Callback.run_handle_message(step.worker, input.name, message, step.context),
         {:ok, step} <- CallbackRunner.try_result(step, core, actions) do
      step
    else
      {:error, error} -> handle_error(step, error, input, message)
    end
  end

  defp handle_error(step, error, input, message),
    do: CallbackRunner.handle_error(step, Callback.add_message_info(error, input.name, message))

  defp take_closing(step, input) do
    case Input.pop(input, 0) do
      {{:closed, time}, input} -> step |> Step.put_input(input) |> close_input(input, time)
      {nil, input} -> Step.put_input(step, input)
    end
  end

  # The pipeline's server closes the outputs once all inputs of the stage have closed. A step that gets its messages
  # from this process closes its outputs with its input.
  defp close_input(step, %{name: name, tag: tag, producer: producer}, time) do
    %{work: work} = step = send_pending(step, false)
    ended = [Map.fetch!(step.inputs.by_tag, tag) | work.ended]
    {known?, inputs} = Inputs.close_input(step.inputs, name, tag)
    step = %{step | inputs: inputs, work: %{work | ended: ended}}

    step =
      if not known? and step.phase != :failed and is_struct(step.worker, Callback),
        do: CallbackRunner.call_callback(step, :handle_closed, [name, time]),
        else: step

    if producer == nil,
      do: Step.map_outputs(step, &Output.close(&1, time)),
      else: %{step | work: Work.add_closing(step.work, {tag, name, time})}
  end

  # A failed step discards incoming messages, so that producers do not wait for it.
  defp discard_inputs(step) do
    Enum.reduce(Map.values(step.inputs.by_tag), step, fn input, step ->
      {time, input} = Input.discard_all(input)
      step = Step.put_input(step, input)
      if time, do: close_input(step, input, time), else: step
    end)
  end

  @doc """
  Ends a time slice: sends messages, publishes counts, and sets the alarm. With `all_sent?: false`, messages that other
  steps have made of these inputs still wait in the stage.
  """
  @spec settle(Step.t(), boolean()) :: Step.t()
  def settle(step, all_sent? \\ true),
    do: step |> end_linger() |> send_pending(all_sent?) |> report_closings() |> release()

  # Counts and demand are published when everything made of the inputs has been sent: a process that replaces this one
  # receives the rest again.
  defp send_pending(%{host: %{restarts?: restarts?}} = step, all_sent?) do
    outputs = Outputs.flush(step.outputs, step.context.now)
    step = %{step | outputs: outputs}

    cond do
      not restarts? ->
        publish_counts(step)

      all_sent? and Outputs.all_sent?(outputs) ->
        publish_counts(%{step | outputs: Outputs.record_progress(outputs)})

      true ->
        step
    end
  end

  defp publish_counts(%{work: %{ended: [_ | _] = ended, spent: {n, ns}} = work} = step) do
    Enum.each(ended, &Input.acknowledge_end(&1, div(ns, max(n, 1))))
    publish_counts(%{step | work: %{work | ended: []}})
  end

  defp publish_counts(%{work: %{spent: spent} = work} = step) do
    work = if spent == {0, 0}, do: work, else: %{work | spent: {0, 0}}
    %{step | inputs: Inputs.settle_touched(step.inputs, spent), work: work}
  end

  # An input counts as closed once the component has emitted everything for it.
  defp report_closings(%{work: %{closings: []}} = step), do: step

  defp report_closings(%{work: work} = step) do
    if step.phase != :failed and Work.unfinished?(work) do
      step
    else
      for {tag, name, time} <- work.closings,
          do: Step.report_event(step, {:unsubscribed, tag, name, time})

      %{step | work: %{work | closings: []}}
    end
  end

  # A pipeline that ends does not wait for messages that a component holds back.
  defp end_linger(%{work: %{lingers: true}, phase: :running} = step) do
    if Step.final_time(step) == Step.no_final_time(),
      do: step,
      else: CallbackRunner.call_callback(step, :handle_info, [{:linger, :end}])
  end

  defp end_linger(step), do: step

  # A chain has nothing that waits for its time.
  defp release(%{worker: %Chain{}} = step), do: step
  defp release(%{host: %{clock: nil}} = step), do: step

  defp release(step) do
    step = Production.report_released(step)

    if not step.context.enforced? and Timers.idle?(step.timers) do
      step
    else
      # `nil` is more than any number.
      due = min(Timers.next_time(step.timers), Outputs.next_time(step.outputs))
      %{step | timers: Timers.set_alarm(step.timers, due, step.host.clock)}
    end
  end

  @doc "Runs the timers that are due and releases the messages whose time has come."
  @spec run_due(Step.t()) :: Step.t()
  def run_due(step) do
    %{context: %{now: now}} = step = Step.read_clock(step)
    {keys, timers} = Timers.take_due(Timers.clear_alarm(step.timers), now)
    outputs = Outputs.release_due(step.outputs, now)
    step = Step.wake_source(%{step | timers: timers, outputs: outputs})

    Enum.reduce(keys, step, fn
      _key, %{phase: :failed} = step -> step
      key, step -> CallbackRunner.call_callback(step, :handle_info, [{:timer, key}])
    end)
  end
end

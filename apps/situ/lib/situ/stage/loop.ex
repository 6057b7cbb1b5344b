defmodule Situ.Stage.Loop do
  @moduledoc false
  # Runs a time slice of a stage: it handles messages until there are none, the outputs are full, or the slice is over.
  # Then the stage takes the next entry of its mailbox. While another slice is scheduled (Pace), new messages only
  # queue.
  alias Situ.Clock
  alias Situ.Clock.Timers
  alias Situ.Ports.{Input, Inputs, Outputs}

  alias Situ.Stage.{
    CallbackRunner,
    ChainRunner,
    ActionRunner,
    MessageRunner,
    Scheduling,
    Production,
    State
  }

  @slice_ns 5_000_000
  @flush_ns 200_000
  @many 64

  @doc "Handles a batch at the input `tag`, or `{:fresh, batch}`: all messages held by a lossy input's producer."
  @spec handle_batch(State.t(), Input.t(), [Situ.Message.t()] | {:fresh, [Situ.Message.t()]}) ::
          State.t()
  def handle_batch(state, input, {:fresh, batch}),
    do: state |> put_input(Input.push_refreshed(input, batch)) |> run_slice()

  # A chain that has waited for it.
  def handle_batch(
        %{callback: nil, phase: :running, pace: %{scheduled: false}} = state,
        %{queue: nil, front: [], rear: []} = input,
        [_ | _] = batch
      ) do
    input = Input.push(input, batch)
    room = Outputs.available_room(state.outputs)

    if room < 1 do
      put_input(state, input)
    else
      now = Clock.now(state.clock)
      take(state, input, room, {now, now + @slice_ns, State.final_time(state)})
    end
  end

  def handle_batch(state, input, batch),
    do: state |> put_input(Input.push(input, batch)) |> turn_if_room()

  @doc "Handles new demand of a consumer."
  @spec handle_demand(State.t(), Outputs.t()) :: State.t()
  # Nothing waits in the chain: there is nothing to do.
  def handle_demand(%{callback: nil, phase: :running, inputs: inputs} = state, outputs) do
    state = %{state | outputs: outputs}
    if idle?(Inputs.single_input(inputs), outputs), do: state, else: turn_if_room(state)
  end

  def handle_demand(state, outputs),
    do: turn_if_room(State.wake_source(%{state | outputs: outputs}))

  # Everything was settled when the last turn ended: without room, or with another turn on its way, there is nothing
  # to do.
  defp turn_if_room(%{pace: %{scheduled: true}} = state), do: state

  defp turn_if_room(%{phase: :running} = state),
    do: if(Outputs.available_room(state.outputs) < 1, do: state, else: run_slice(state))

  defp turn_if_room(state), do: run_slice(state)

  @doc "Closes the input after its waiting messages."
  @spec handle_closing(State.t(), Input.t(), Situ.Time.t()) :: State.t()
  def handle_closing(state, input, time),
    do: state |> put_input(Input.push_closed(input, time)) |> run_slice()

  @doc "Handles a plain message for the component."
  @spec handle_plain_message(State.t(), term()) :: State.t()
  # A neighbour that started sooner may have closed already, a producer from outside may have failed: their words wait
  # until this stage runs, and an error is then what `on_error` says.
  def handle_plain_message(%{phase: :starting, pace: pace} = state, message),
    do: %{state | pace: %{pace | early: [message | pace.early]}}

  def handle_plain_message(%{callback: nil} = state, _message), do: state
  def handle_plain_message(%{phase: :failed} = state, _message), do: state

  def handle_plain_message(state, message) do
    now = Clock.now(state.clock)

    state
    |> State.wake_source()
    |> CallbackRunner.call_callback(:handle_info, [message], now)
    |> run_slice()
  end

  @doc "Handles, in order, the plain messages that arrived before the stage was running."
  @spec handle_early(State.t()) :: State.t()
  def handle_early(%{pace: %{early: early} = pace} = state) do
    early
    |> Enum.reverse()
    |> Enum.reduce(%{state | pace: %{pace | early: []}}, &handle_plain_message(&2, &1))
  end

  @doc "Handles a request of another process to the component (`from` is `nil` for a cast)."
  @spec handle_request(State.t(), term(), GenServer.from() | nil) :: State.t()
  def handle_request(state, request, from),
    do:
      state |> State.wake_source() |> CallbackRunner.handle_request(request, from) |> run_slice()

  @doc "Sets whether the stage takes and sends messages (`:forward`) or not (`:accumulate`)."
  @spec set_demand(State.t(), :accumulate | :forward) :: State.t()
  def set_demand(state, mode),
    do: state |> State.set_demand(mode) |> State.wake_source() |> run_slice()

  @doc "Handles the alarm: runs due timers and releases messages whose time has come."
  @spec handle_alarm(State.t()) :: State.t()
  # It is set again when the stage runs.
  def handle_alarm(%{phase: :starting} = state),
    do: %{state | timers: Timers.clear_alarm(state.timers)}

  def handle_alarm(state) do
    now = Clock.now(state.clock)
    {keys, timers} = Timers.take_due(Timers.clear_alarm(state.timers), now)
    outputs = Outputs.release_due(state.outputs, now)
    state = State.wake_source(%{state | timers: timers, outputs: outputs})
    keys |> Enum.reduce(state, &timer(&1, &2, now)) |> ActionRunner.send_pending() |> run_slice()
  end

  defp timer(_key, %{phase: :failed} = state, _now), do: state

  defp timer(key, state, now),
    do: CallbackRunner.call_callback(state, :handle_info, [{:timer, key}], now)

  @doc "Runs a time slice; if one is already scheduled, only sends pending messages."
  @spec run_slice(State.t()) :: State.t()
  def run_slice(%{pace: %{scheduled: true}} = state), do: finish(state)

  def run_slice(%{phase: :running, callback: nil} = state) do
    if idle?(Inputs.single_input(state.inputs), state.outputs) do
      finish(state)
    else
      now = Clock.now(state.clock)
      chain(state, now, now + @slice_ns, State.final_time(state))
    end
  end

  def run_slice(%{phase: :running} = state) do
    now = Clock.now(state.clock)
    final = State.final_time(state)
    state |> unlock(final) |> component(now, {now, now + @slice_ns}, final)
  end

  def run_slice(%{phase: :failed} = state), do: discard(state)
  def run_slice(state), do: finish(state)

  # Nothing to take, or no room for what would come of it.
  defp idle?(nil, _outputs), do: true
  defp idle?(input, outputs), do: Input.empty?(input) or Outputs.available_room(outputs) < 1

  # A pipeline that ends does not wait for a paused stage to resume.
  defp unlock(%{outputs: %{demand: :accumulate}} = state, final),
    do: if(final == State.no_final_time(), do: state, else: State.set_demand(state, :forward))

  defp unlock(state, _final), do: state

  @doc "Runs the scheduled time slice."
  @spec run_scheduled_slice(State.t()) :: State.t()
  def run_scheduled_slice(%{pace: pace} = state),
    do: run_slice(%{state | pace: %{pace | scheduled: false}})

  # Sends pending messages, and sets the timer for messages that wait for their time.
  # A chain has nothing that waits for its time.
  defp finish(%{callback: nil} = state), do: ActionRunner.send_pending(state)

  defp finish(%{pace: %{lingers: true}, phase: :running} = state),
    do: state |> hurry(State.final_time(state)) |> released()

  defp finish(state), do: released(state)

  # Nor does it wait for messages that a component holds back.
  defp hurry(state, final) do
    if final == State.no_final_time(),
      do: state,
      else:
        CallbackRunner.call_callback(
          state,
          :handle_info,
          [{:linger, :end}],
          Clock.now(state.clock)
        )
  end

  defp released(state),
    do: state |> MessageRunner.settle_inputs() |> Production.report_released() |> arm()

  defp schedule_slice(state) do
    state = finish(state)
    %{state | pace: Scheduling.schedule_slice(state.pace)}
  end

  defp arm(%{clock: nil} = state), do: state

  defp arm(state) do
    if not state.context.enforced? and Timers.idle?(state.timers) do
      state
    else
      # `nil` is more than any number.
      due = min(Timers.next_time(state.timers), Outputs.next_time(state.outputs))
      %{state | timers: Timers.set_alarm(state.timers, due, state.clock)}
    end
  end

  # A component: one message at a time, the earliest among its inputs first.
  defp component(state, now, {_from, till} = times, final) do
    cond do
      now > till -> schedule_slice(state)
      Outputs.available_room(state.outputs) < 1 -> blocked(state, now, times, final)
      true -> next(state, now, times, final)
    end
  end

  defp blocked(state, now, times, final) do
    state = ActionRunner.send_pending(state)

    if Outputs.available_room(state.outputs) < 1,
      do: finish(state),
      else: next(state, now, times, final)
  end

  # The component has more output for the messages it has received.
  defp next(%{pace: %{continue: {:some, term}}} = state, now, times, final) do
    state = %{state | pace: %{state.pace | continue: :none}}
    state = CallbackRunner.call_callback(state, :handle_info, [{:continue, term}], now)
    go_on({MessageRunner.settle_inputs(state), Clock.now(state.clock)}, times, final)
  end

  defp next(state, now, times, final) do
    case Inputs.earliest_input(state.inputs) do
      nil ->
        produce(state, now)

      %{queue: nil, check: :off} = input when state.callback.batch ->
        state |> MessageRunner.run_batch(input, now, final) |> go_on(times, final)

      %{queue: nil} = input ->
        state |> MessageRunner.run_next(input, now, final) |> go_on(times, final)

      input ->
        lossy(state, input, now, times, final)
    end
  end

  # Messages in the mailbox join the queue before the next message is taken.
  defp lossy(state, input, now, times, final) do
    case Input.ensure_fresh(input) do
      {:wait, input} ->
        state |> put_input(input) |> component(now, times, final)

      {:ok, input} ->
        {state, _now} = MessageRunner.run_next(state, input, now, final)
        if state.phase == :failed, do: discard(state), else: schedule_slice(state)
    end
  end

  defp produce(state, now) do
    case Production.produce_messages(ActionRunner.send_pending(state), now) do
      {:more, state} -> schedule_slice(state)
      {:enough, %{phase: :failed} = state} -> discard(state)
      {:enough, state} -> finish(state)
    end
  end

  defp go_on({%{phase: :failed} = state, _now}, _times, _final), do: discard(state)

  defp go_on({state, now}, {from, till}, final) do
    if now - from > @flush_ns,
      do: component(ActionRunner.send_pending(state), now, {now, till}, final),
      else: component(state, now, {from, till}, final)
  end

  # A chain runs as many messages together as there is room for. Slices grow while they are quick.
  defp chain(state, now, till, final) do
    case Inputs.single_input(state.inputs) do
      nil -> finish(state)
      input -> take(state, input, Outputs.available_room(state.outputs), {now, till, final})
    end
  end

  defp take(state, _input, room, _times) when is_integer(room) and room < 1, do: finish(state)

  defp take(state, %{queue: nil} = input, room, {now, _till, _final} = times) do
    case Input.take_batch(input, min(room, state.pace.slice)) do
      {[], %{front: [{:closed, time} | _]} = input} ->
        {_closed, input} = Input.pop(input, now)
        state |> ActionRunner.send_pending() |> MessageRunner.close_input(input, time)

      {[], input} ->
        state |> put_input(input) |> finish()

      {messages, input} ->
        {state, done, now} = run(put_input(state, input), messages, times)
        chain_on(state, done, now, times)
    end
  end

  defp take(state, input, _room, {now, _till, _final} = times) do
    with time when time != :none <- Input.head_time(input),
         {:ok, input} <- Input.ensure_fresh(input),
         {%Situ.Message{} = message, input} <- Input.pop(input, now) do
      {state, _n, _now} = run(put_input(state, input), [message], times)
      if state.phase == :failed, do: discard(state), else: schedule_slice(state)
    else
      :none ->
        finish(state)

      {:wait, input} ->
        state |> put_input(input) |> finish()

      {nil, input} ->
        state |> put_input(input) |> finish()

      {{:closed, time}, input} ->
        state |> ActionRunner.send_pending() |> MessageRunner.close_input(input, time)
    end
  end

  defp run(state, messages, {now, _till, final}) do
    {state, last, n, rest} = ChainRunner.run_batch(state, messages, now, final)
    after_time = Clock.now(state.clock)
    input = state.inputs |> Inputs.single_input() |> Input.put_back(rest)

    input =
      if n > 0, do: Input.count_handled(input, n, last, {now, after_time - now}), else: input

    pace = pace(state.pace, n, rest, after_time - now)
    {put_input(%{state | pace: pace}, input), {n, rest}, after_time}
  end

  defp pace(pace, n, [], elapsed), do: Scheduling.resize_slice(pace, n, elapsed)
  defp pace(pace, n, _rest, _elapsed), do: Scheduling.shrink_slice(pace, n)

  defp chain_on(state, {n, rest}, after_time, {now, till, final}) do
    cond do
      state.phase == :failed -> discard(state)
      after_time > till or rest != [] -> schedule_slice(state)
      n >= @many and after_time - now < @flush_ns -> chain(state, after_time, till, final)
      true -> state |> ActionRunner.send_pending() |> chain_again(after_time, till, final)
    end
  end

  defp chain_again(state, now, till, final) do
    if idle?(Inputs.single_input(state.inputs), state.outputs),
      do: state,
      else: chain(state, now, till, final)
  end

  # A failed stage discards incoming messages, so that producers do not wait for it.
  defp discard(state) do
    inputs = Map.values(state.inputs.by_tag)

    inputs
    |> Enum.reduce(state, fn input, state ->
      {time, input} = Input.discard_all(input)
      state = put_input(state, input)
      if time, do: MessageRunner.close_input(state, input, time), else: state
    end)
    |> finish()
  end

  defp put_input(state, input), do: %{state | inputs: Inputs.put(state.inputs, input)}
end

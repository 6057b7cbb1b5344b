defmodule Situ.Stage.Loop do
  @moduledoc false
  # Runs a time slice of a stage: it handles messages until there are none, the outputs are full, or the slice is over.
  # Then the stage takes the next entry of its mailbox. While another slice is scheduled (Pace), new messages only
  # queue.
  alias Situ.Clock
  alias Situ.Clock.Timers
  alias Situ.Ports.{Input, Inputs, Outputs}
  alias Situ.Stage.{Activation, ChainRunner, Emission, MessageRunner, Pace, Production, State}

  @slice_ns 5_000_000
  @flush_ns 200_000
  @many 64

  @doc "Handles a batch at the input `tag`, or `{:fresh, batch}`: all messages held by a lossy input's producer."
  @spec arrived(State.t(), Input.t(), [Situ.Message.t()] | {:fresh, [Situ.Message.t()]}) ::
          State.t()
  def arrived(state, input, {:fresh, batch}),
    do: state |> put_input(Input.refreshed(input, batch)) |> turn()

  # A chain that has waited for it.
  def arrived(
        %{callback: nil, phase: :running, pace: %{scheduled: false}} = state,
        %{queue: nil, front: [], rear: []} = input,
        [_ | _] = batch
      ) do
    input = Input.push(input, batch)
    room = Outputs.room(state.outputs)

    if room < 1 do
      put_input(state, input)
    else
      now = Clock.now(state.clock)
      take(state, input, room, {now, now + @slice_ns, State.final(state)})
    end
  end

  def arrived(state, input, batch),
    do: state |> put_input(Input.push(input, batch)) |> turn_if_room()

  @doc "Handles new demand of a consumer."
  @spec asked(State.t(), Outputs.t()) :: State.t()
  # Nothing waits in the chain: there is nothing to do.
  def asked(%{callback: nil, phase: :running, inputs: inputs} = state, outputs) do
    state = %{state | outputs: outputs}
    if idle?(Inputs.only(inputs), outputs), do: state, else: turn_if_room(state)
  end

  def asked(state, outputs), do: turn_if_room(State.wake(%{state | outputs: outputs}))

  # Everything was settled when the last turn ended: without room, or with another turn on its way, there is nothing
  # to do.
  defp turn_if_room(%{pace: %{scheduled: true}} = state), do: state

  defp turn_if_room(%{phase: :running} = state),
    do: if(Outputs.room(state.outputs) < 1, do: state, else: turn(state))

  defp turn_if_room(state), do: turn(state)

  @doc "Closes the input after its waiting messages."
  @spec closing(State.t(), Input.t(), Situ.Time.t()) :: State.t()
  def closing(state, input, time),
    do: state |> put_input(Input.push_closed(input, time)) |> turn()

  @doc "Handles a plain message for the component."
  @spec info(State.t(), term()) :: State.t()
  # A neighbour that started sooner may have closed already, a producer from outside may have failed: their words wait
  # until this stage runs, and an error is then what `on_error` says.
  def info(%{phase: :starting, pace: pace} = state, message),
    do: %{state | pace: %{pace | early: [message | pace.early]}}

  def info(%{callback: nil} = state, _message), do: state
  def info(%{phase: :failed} = state, _message), do: state

  def info(state, message) do
    now = Clock.now(state.clock)
    state |> State.wake() |> Activation.call(:handle_info, [message], now) |> turn()
  end

  @doc "Handles, in order, the plain messages that arrived before the stage was running."
  @spec early(State.t()) :: State.t()
  def early(%{pace: %{early: early} = pace} = state) do
    early
    |> Enum.reverse()
    |> Enum.reduce(%{state | pace: %{pace | early: []}}, &info(&2, &1))
  end

  @doc "Handles a request of another process to the component (`from` is `nil` for a cast)."
  @spec request(State.t(), term(), GenServer.from() | nil) :: State.t()
  def request(state, request, from),
    do: state |> State.wake() |> Activation.request(request, from) |> turn()

  @doc "Sets whether the stage takes and sends messages (`:forward`) or not (`:accumulate`)."
  @spec demand(State.t(), :accumulate | :forward) :: State.t()
  def demand(state, mode),
    do: state |> State.demand(mode) |> State.wake() |> turn()

  @doc "Handles the alarm: runs due timers and releases messages whose time has come."
  @spec ring(State.t()) :: State.t()
  # It is set again when the stage runs.
  def ring(%{phase: :starting} = state), do: %{state | timers: Timers.rang(state.timers)}

  def ring(state) do
    now = Clock.now(state.clock)
    {keys, timers} = Timers.due(Timers.rang(state.timers), now)
    outputs = Outputs.release(state.outputs, now)
    state = State.wake(%{state | timers: timers, outputs: outputs})
    keys |> Enum.reduce(state, &timer(&1, &2, now)) |> Emission.settle() |> turn()
  end

  defp timer(_key, %{phase: :failed} = state, _now), do: state
  defp timer(key, state, now), do: Activation.call(state, :handle_info, [{:timer, key}], now)

  @doc "Runs a time slice; if one is already scheduled, only sends pending messages."
  @spec turn(State.t()) :: State.t()
  def turn(%{pace: %{scheduled: true}} = state), do: finish(state)

  def turn(%{phase: :running, callback: nil} = state) do
    if idle?(Inputs.only(state.inputs), state.outputs) do
      finish(state)
    else
      now = Clock.now(state.clock)
      chain(state, now, now + @slice_ns, State.final(state))
    end
  end

  def turn(%{phase: :running} = state) do
    now = Clock.now(state.clock)
    final = State.final(state)
    state |> unlock(final) |> component(now, {now, now + @slice_ns}, final)
  end

  def turn(%{phase: :failed} = state), do: discard(state)
  def turn(state), do: finish(state)

  # Nothing to take, or no room for what would come of it.
  defp idle?(nil, _outputs), do: true
  defp idle?(input, outputs), do: Input.empty?(input) or Outputs.room(outputs) < 1

  # A pipeline that ends does not wait for somebody to let it go on.
  defp unlock(%{outputs: %{demand: :accumulate}} = state, final),
    do: if(final == State.never(), do: state, else: State.demand(state, :forward))

  defp unlock(state, _final), do: state

  @doc "Runs the scheduled time slice."
  @spec again(State.t()) :: State.t()
  def again(%{pace: pace} = state), do: turn(%{state | pace: %{pace | scheduled: false}})

  # Sends what is pending, and sets the alarm for what waits for its time.
  # A chain has nothing that waits for its time.
  defp finish(%{callback: nil} = state), do: Emission.settle(state)

  defp finish(%{pace: %{lingers: true}, phase: :running} = state),
    do: state |> hurry(State.final(state)) |> released()

  defp finish(state), do: released(state)

  # Nor does it wait until a component has given what it keeps for later.
  defp hurry(state, final) do
    if final == State.never(),
      do: state,
      else: Activation.call(state, :handle_info, [{:linger, :end}], Clock.now(state.clock))
  end

  defp released(state), do: state |> MessageRunner.settled() |> Production.released() |> arm()

  defp later(state) do
    state = finish(state)
    %{state | pace: Pace.schedule(state.pace)}
  end

  defp arm(%{clock: nil} = state), do: state

  defp arm(state) do
    if not state.context.enforced? and Timers.idle?(state.timers) do
      state
    else
      # `nil` is more than any number.
      due = min(Timers.next_time(state.timers), Outputs.next_time(state.outputs))
      %{state | timers: Timers.arm(state.timers, due, state.clock)}
    end
  end

  # A component: one message at a time, the earliest among its inputs first.
  defp component(state, now, {_from, till} = times, final) do
    cond do
      now > till -> later(state)
      Outputs.room(state.outputs) < 1 -> blocked(state, now, times, final)
      true -> next(state, now, times, final)
    end
  end

  defp blocked(state, now, times, final) do
    state = Emission.settle(state)
    if Outputs.room(state.outputs) < 1, do: finish(state), else: next(state, now, times, final)
  end

  # The component has more to give for what it has taken in.
  defp next(%{pace: %{continue: {:some, term}}} = state, now, times, final) do
    state = %{state | pace: %{state.pace | continue: :none}}
    state = Activation.call(state, :handle_info, [{:continue, term}], now)
    go_on({MessageRunner.settled(state), Clock.now(state.clock)}, times, final)
  end

  defp next(state, now, times, final) do
    case Inputs.earliest(state.inputs) do
      nil ->
        produce(state, now)

      %{queue: nil, check: :off} = input when state.callback.batch ->
        state |> MessageRunner.batch(input, now, final) |> go_on(times, final)

      %{queue: nil} = input ->
        state |> MessageRunner.one(input, now, final) |> go_on(times, final)

      input ->
        lossy(state, input, now, times, final)
    end
  end

  # Messages in the mailbox join the queue before the next message is taken.
  defp lossy(state, input, now, times, final) do
    case Input.freshen(input) do
      {:wait, input} ->
        state |> put_input(input) |> component(now, times, final)

      {:ok, input} ->
        {state, _now} = MessageRunner.one(state, input, now, final)
        if state.phase == :failed, do: discard(state), else: later(state)
    end
  end

  defp produce(state, now) do
    case Production.produce(Emission.settle(state), now) do
      {:more, state} -> later(state)
      {:enough, %{phase: :failed} = state} -> discard(state)
      {:enough, state} -> finish(state)
    end
  end

  defp go_on({%{phase: :failed} = state, _now}, _times, _final), do: discard(state)

  defp go_on({state, now}, {from, till}, final) do
    if now - from > @flush_ns,
      do: component(Emission.settle(state), now, {now, till}, final),
      else: component(state, now, {from, till}, final)
  end

  # A chain: as many messages at once as there is room for; slices grow while they are quick.
  defp chain(state, now, till, final) do
    case Inputs.only(state.inputs) do
      nil -> finish(state)
      input -> take(state, input, Outputs.room(state.outputs), {now, till, final})
    end
  end

  defp take(state, _input, room, _times) when is_integer(room) and room < 1, do: finish(state)

  defp take(state, %{queue: nil} = input, room, {now, _till, _final} = times) do
    case Input.take(input, min(room, state.pace.slice)) do
      {[], %{front: [{:closed, time} | _]} = input} ->
        {_closed, input} = Input.pop(input, now)
        state |> Emission.settle() |> MessageRunner.closed(input, time)

      {[], input} ->
        state |> put_input(input) |> finish()

      {messages, input} ->
        {state, done, now} = run(put_input(state, input), messages, times)
        chain_on(state, done, now, times)
    end
  end

  defp take(state, input, _room, {now, _till, _final} = times) do
    with time when time != :none <- Input.head_time(input),
         {:ok, input} <- Input.freshen(input),
         {%Situ.Message{} = message, input} <- Input.pop(input, now) do
      {state, _n, _now} = run(put_input(state, input), [message], times)
      if state.phase == :failed, do: discard(state), else: later(state)
    else
      :none -> finish(state)
      {:wait, input} -> state |> put_input(input) |> finish()
      {nil, input} -> state |> put_input(input) |> finish()
      {{:closed, time}, input} -> state |> Emission.settle() |> MessageRunner.closed(input, time)
    end
  end

  defp run(state, messages, {now, _till, final}) do
    {state, last, n, rest} = ChainRunner.batch(state, messages, now, final)
    after_time = Clock.now(state.clock)
    input = state.inputs |> Inputs.only() |> Input.put_back(rest)
    input = if n > 0, do: Input.handled(input, n, last, {now, after_time - now}), else: input
    pace = pace(state.pace, n, rest, after_time - now)
    {put_input(%{state | pace: pace}, input), {n, rest}, after_time}
  end

  defp pace(pace, n, [], elapsed), do: Pace.resize(pace, n, elapsed)
  defp pace(pace, n, _rest, _elapsed), do: Pace.slow(pace, n)

  defp chain_on(state, {n, rest}, after_time, {now, till, final}) do
    cond do
      state.phase == :failed -> discard(state)
      after_time > till or rest != [] -> later(state)
      n >= @many and after_time - now < @flush_ns -> chain(state, after_time, till, final)
      true -> state |> Emission.settle() |> chain_again(after_time, till, final)
    end
  end

  defp chain_again(state, now, till, final) do
    if idle?(Inputs.only(state.inputs), state.outputs),
      do: state,
      else: chain(state, now, till, final)
  end

  # A stage that has failed takes what comes and throws it away, so that nobody waits for it.
  defp discard(state) do
    inputs = Map.values(state.inputs.by_tag)

    inputs
    |> Enum.reduce(state, fn input, state ->
      {time, input} = Input.discard(input)
      state = put_input(state, input)
      if time, do: MessageRunner.closed(state, input, time), else: state
    end)
    |> finish()
  end

  defp put_input(state, input), do: %{state | inputs: Inputs.put(state.inputs, input)}
end

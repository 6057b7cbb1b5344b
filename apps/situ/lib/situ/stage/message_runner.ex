defmodule Situ.Stage.MessageRunner do
  @moduledoc false
  # Runs one message or a batch through a component: calls the callback, applies the result and counts.
  alias Situ.Clock
  alias Situ.Component.Callback
  alias Situ.Ports.{Input, Inputs, Outputs}
  alias Situ.Stage.{CallbackRunner, ActionRunner, Scheduling, State}

  @doc "Handles the next entry of an input at clock time `now`; returns the time after it."
  @spec run_next(State.t(), Input.t(), Situ.Time.t(), integer()) :: {State.t(), Situ.Time.t()}
  def run_next(state, input, now, final) do
    {entry, input} = Input.pop(input, now)
    entry(entry, state, input, now, final)
  end

  defp entry(nil, state, input, now, _final), do: {put_input(state, input), now}

  defp entry({:closed, time}, state, input, now, _final),
    do:
      {state |> put_input(input) |> ActionRunner.send_pending() |> close_input(input, time), now}

  defp entry(%{originating_time: time}, state, input, now, final) when time > final,
    do: {put_input(state, Input.drop_taken(input, 1)), now}

  defp entry(message, state, input, now, _final) do
    state = handle(put_input(state, input), input, message, now)
    after_time = Clock.now(state.clock)

    # Whether it is held, and whether it is there at all, is for the component to say, and it may just have said so.
    input = Map.get(state.inputs.by_tag, input.tag, input)
    input = Input.count_handled(input, 1, message.originating_time, {now, after_time - now})
    {put_input(state, input), after_time}
  end

  defp handle(state, %{check: :off} = input, message, now), do: call(state, input, message, now)

  defp handle(state, input, message, now) do
    case Input.check_type(input, message, state.callback.path) do
      {:ok, input} -> state |> put_input(input) |> call(input, message, now)
      {:error, error} -> wrong(state, error, input, message)
    end
  end

  defp call(state, input, message, now) do
    context = State.context_at(state, now)

    with {:ok, actions, core} <-
           Callback.run_handle_message(state.callback, input.name, message, context),
         after_call = %{state | callback: %{state.callback | core: core}},
         {:ok, state} <- ActionRunner.apply_actions(after_call, actions, now) do
      state
    else
      {:error, error} -> wrong(state, error, input, message)
    end
  end

  defp wrong(state, error, input, message),
    do: CallbackRunner.handle_error(state, Callback.add_message_info(error, input.name, message))

  @doc "Passes the waiting messages to `handle_messages/4` in one batch, as far as time and room allow."
  @spec run_batch(State.t(), Input.t(), Situ.Time.t(), integer()) :: {State.t(), Situ.Time.t()}
  def run_batch(%{pace: %{singly: n} = pace} = state, input, now, final) when n > 0,
    do: run_next(%{state | pace: %{pace | singly: n - 1}}, input, now, final)

  def run_batch(state, input, now, final) do
    room = min(Outputs.available_room(state.outputs), state.pace.slice)

    case Input.take_batch(input, room) do
      {[_, _ | _] = messages, rest} -> try_batch(state, input, {messages, rest}, now, final)
      _ -> run_next(state, input, now, final)
    end
  end

  defp try_batch(state, input, {messages, rest}, now, final) do
    last = List.last(messages).originating_time
    context = State.context_at(state, now)

    with true <- last <= final,
         {:ok, actions, core} <-
           Callback.run_handle_messages(state.callback, input.name, messages, context),
         after_call = %{state | callback: %{state.callback | core: core}},
         {:ok, state} <- ActionRunner.apply_actions(after_call, actions, now) do
      after_time = Clock.now(state.clock)
      n = length(messages)
      rest = %{rest | held: Map.fetch!(state.inputs.by_tag, input.tag).held}
      rest = Input.count_handled(rest, n, last, {now, after_time - now})
      pace = Scheduling.resize_slice(state.pace, n, after_time - now)
      {put_input(%{state | pace: pace}, rest), after_time}
    else
      # All of it is taken one by one, before another batch is tried.
      _ -> run_batch(%{state | pace: %{state.pace | singly: length(messages)}}, input, now, final)
    end
  end

  @doc "Handles an input that has closed after its last message."
  @spec close_input(State.t(), Input.t(), Situ.Time.t()) :: State.t()
  def close_input(state, input, time) do
    {known?, inputs} = Inputs.close_input(state.inputs, input)
    state = %{state | inputs: inputs}

    state =
      if state.callback != nil and state.phase != :failed and not known?,
        do:
          CallbackRunner.call_callback(
            state,
            :handle_closed,
            [input.name, time],
            Clock.now(state.clock)
          ),
        else: state

    settle_inputs(%{
      state
      | pace: %{state.pace | closings: state.pace.closings ++ [{input.tag, input.name, time}]}
    })
  end

  @doc "Sends pending messages; an input counts as closed once the component has emitted everything for it."
  @spec settle_inputs(State.t()) :: State.t()
  def settle_inputs(%{pace: %{closings: []}} = state), do: ActionRunner.send_pending(state)

  def settle_inputs(%{phase: phase, pace: %{continue: continue, lingers: lingers?}} = state)
      when phase != :failed and (lingers? or continue != :none),
      do: ActionRunner.send_pending(state)

  def settle_inputs(state) do
    state = ActionRunner.send_pending(state)

    for {tag, name, time} <- state.pace.closings,
        do: State.report_event(state, {:unsubscribed, tag, name, time})

    %{state | pace: %{state.pace | closings: []}}
  end

  defp put_input(state, input), do: %{state | inputs: Inputs.put(state.inputs, input)}
end

defmodule Situ.Fusion.Balance do
  @moduledoc false
  # Keeps the inputs of a fusion operator close together, so that memory does not depend on which of two sources runs
  # more often. An input that is far ahead of the awaited one is held temporarily.
  # A hold is never permanent, since the awaited input may depend on the held one (both may come from one source, one
  # of them through a filter). If no message arrives during a hold, the input is released and the limit is doubled.
  # Such a graph costs a few holds and the memory it needs. While other processes of the VM are busy, one of them may
  # be about to send the awaited message and only be waiting for a core. In that case the release comes after up to 25
  # holds (half a second).
  # The length of a queue is the newest sequence id minus the sequence id of its head.
  # See docs/adr/0021-fusion-holds-inputs-that-run-ahead.md.

  @limit 8_192
  @patience 25

  alias Situ.Fusion.MessageQueue

  defstruct limit: @limit, newest: %{}, held_inputs: [], idle: 0

  @doc "Builds a balance for inputs that may run ahead by about 8,000 messages, or by half of `max_queue`."
  @spec new(pos_integer() | nil) :: t()
  def new(nil), do: %__MODULE__{}
  def new(max_queue), do: %__MODULE__{limit: max(min(@limit, div(max_queue, 2)), 1)}

  @type input :: atom()
  @type t :: %__MODULE__{
          limit: pos_integer(),
          newest: %{input() => non_neg_integer()},
          held_inputs: [input()],
          idle: non_neg_integer()
        }

  @doc "Records that messages of `input` have arrived."
  @spec note_arrival(t(), input(), [Situ.Message.t()]) :: t()
  def note_arrival(balance, input, messages),
    do: %{
      balance
      | newest: Map.put(balance.newest, input, MessageQueue.last_message(messages).sequence_id),
        idle: 0
    }

  @doc """
  Returns the outputs of a component, together with the holds and resumes of its inputs, and the updated state, which
  contains the balance under `balance`. `heads` are the inputs' queues, `{input, sequence id of the first message |
  nil}`. `awaited` are the inputs that the operator is waiting for.
  """
  @spec after_step([term()], state, [{input(), non_neg_integer() | nil}], [input()]) ::
          {[term()], state}
        when state: %{:balance => t(), optional(atom()) => term()}
  def after_step(outputs, state, heads, awaited) do
    case hold_actions(state.balance, heads, awaited) do
      {[], balance} -> {outputs, %{state | balance: balance}}
      {actions, balance} -> {outputs ++ actions, %{state | balance: balance}}
    end
  end

  @doc "Handles the end of a hold, as the component's callback of the same name. Other messages are ignored."
  @spec handle_info(term(), state) :: {[term()], state}
        when state: %{:balance => t(), optional(atom()) => term()}
  def handle_info({:hold_ended, input}, state) do
    {actions, balance} = end_hold(state.balance, input, vm_busy?())
    {actions, %{state | balance: balance}}
  end

  def handle_info(_other, state), do: {[], state}

  @doc "Forgets an input that was removed."
  @spec forget_input(t(), input()) :: t()
  def forget_input(balance, input) do
    %{
      balance
      | newest: Map.delete(balance.newest, input),
        held_inputs: List.delete(balance.held_inputs, input)
    }
  end

  @doc """
  Returns the holds and resumes of inputs as actions. `heads` are the inputs' queues, `{input, sequence id of the first
  message | nil}`. `awaited` are the inputs that the operator is waiting for.
  """
  @spec hold_actions(t(), [{input(), non_neg_integer() | nil}], [input()]) :: {list(), t()}
  def hold_actions(balance, heads, awaited) do
    ahead =
      for {input, head} <- heads, head != nil, too_far_ahead?(balance, input, head), do: input

    case {Enum.reject(ahead, &(&1 in awaited)), balance.held_inputs} do
      {[], []} -> {[], balance}
      {same, same} -> {Enum.map(same, &{:hold, &1}), balance}
      {hold, held_inputs} -> {hold_changes(hold, held_inputs), %{balance | held_inputs: hold}}
    end
  end

  @doc "Ends a hold of `input` during which nothing arrived: extends it if the VM was busy, and otherwise releases it."
  @spec end_hold(t(), input(), boolean()) :: {list(), t()}
  def end_hold(%{idle: idle} = balance, input, true) when idle < @patience do
    if input in balance.held_inputs,
      do: {[{:hold, input}], %{balance | idle: idle + 1}},
      else: {[], balance}
  end

  def end_hold(balance, input, _busy?) do
    held_inputs = List.delete(balance.held_inputs, input)
    {[], %{balance | held_inputs: held_inputs, limit: balance.limit * 2, idle: 0}}
  end

  @doc "Returns whether messages are in flight: this process has unread messages, or other processes are running."
  @spec vm_busy?() :: boolean()
  def vm_busy? do
    Process.info(self(), :message_queue_len) != {:message_queue_len, 0} or
      :erlang.statistics(:total_active_tasks) > 1
  end

  defp too_far_ahead?(balance, input, head) do
    limit = if input in balance.held_inputs, do: div(balance.limit, 2), else: balance.limit
    Map.get(balance.newest, input, 0) - head > limit
  end

  defp hold_changes(hold, held_inputs) do
    Enum.map(hold, &{:hold, &1}) ++ Enum.map(held_inputs -- hold, &{:resume, &1})
  end
end

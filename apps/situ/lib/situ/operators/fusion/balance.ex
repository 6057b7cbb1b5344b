defmodule Situ.Fusion.Balance do
  @moduledoc false
  # Keeps the inputs of a fusion operator together, so that memory does not depend on which of two sources runs more
  # often: an input far ahead of the awaited one is held for a moment.
  # It is never held for good, since the awaited input may depend on it (both may come from one source, by way of a
  # filter): when no message has arrived for the time of a hold, the input is released and the limit doubled. Such a
  # graph costs a few such moments, and the memory that it needs. While other processes of the VM are at work, one of
  # them may be about to send the awaited message and only lack a core: then up to 25 holds (half a second) pass
  # before the release.
  # The length of a queue is the newest sequence id less that of the queue's head.

  @limit 8_192
  @patience 25

  alias Situ.Fusion.MessageQueue

  defstruct limit: @limit, newest: %{}, held: [], idle: 0

  @doc "For inputs that may run ahead by some 8,000 messages, or by half of `max_queue`."
  @spec new(pos_integer() | nil) :: t()
  def new(nil), do: %__MODULE__{}
  def new(max_queue), do: %__MODULE__{limit: max(min(@limit, div(max_queue, 2)), 1)}

  @type input :: atom()
  @type t :: %__MODULE__{
          limit: pos_integer(),
          newest: %{input() => non_neg_integer()},
          held: [input()],
          idle: non_neg_integer()
        }

  @doc "Messages of `input` arrived."
  @spec seen(t(), input(), [Situ.Message.t()]) :: t()
  def seen(balance, input, messages),
    do: %{
      balance
      | newest: Map.put(balance.newest, input, MessageQueue.last(messages).sequence_id),
        idle: 0
    }

  @doc """
  The outputs of a component after it has taken something in, with the holds and resumes of its inputs, and its
  state, which keeps the balance under `balance`: `heads` are the inputs' queues, `{input, sequence id of the first
  message | nil}`; `awaited` are the inputs that the operator waits for.
  """
  @spec after_step([term()], state, [{input(), non_neg_integer() | nil}], [input()]) ::
          {[term()], state}
        when state: %{:balance => t(), optional(atom()) => term()}
  def after_step(outputs, state, heads, awaited) do
    case actions(state.balance, heads, awaited) do
      {[], balance} -> {outputs, %{state | balance: balance}}
      {actions, balance} -> {outputs ++ actions, %{state | balance: balance}}
    end
  end

  @doc "As the component's callback of that name: the end of a hold; everything else is ignored."
  @spec handle_info(term(), state) :: {[term()], state}
        when state: %{:balance => t(), optional(atom()) => term()}
  def handle_info({:hold_ended, input}, state) do
    {actions, balance} = ended(state.balance, input, busy?())
    {actions, %{state | balance: balance}}
  end

  def handle_info(_other, state), do: {[], state}

  @doc "`input` is no more."
  @spec forget(t(), input()) :: t()
  def forget(balance, input) do
    %{
      balance
      | newest: Map.delete(balance.newest, input),
        held: List.delete(balance.held, input)
    }
  end

  @doc """
  The inputs to hold and to resume, as actions: `heads` are the inputs' queues, `{input, sequence id of the first
  message | nil}`; `awaited` are the inputs that the operator waits for.
  """
  @spec actions(t(), [{input(), non_neg_integer() | nil}], [input()]) :: {list(), t()}
  def actions(balance, heads, awaited) do
    ahead = for {input, head} <- heads, head != nil, ahead?(balance, input, head), do: input

    case {Enum.reject(ahead, &(&1 in awaited)), balance.held} do
      {[], []} -> {[], balance}
      {same, same} -> {Enum.map(same, &{:hold, &1}), balance}
      {hold, held} -> {change(hold, held), %{balance | held: hold}}
    end
  end

  @doc "Nothing came while `input` was held, and the rest of the VM was `busy?` or not: it is held on, or let go."
  @spec ended(t(), input(), boolean()) :: {list(), t()}
  def ended(%{idle: idle} = balance, input, true) when idle < @patience do
    if input in balance.held,
      do: {[{:hold, input}], %{balance | idle: idle + 1}},
      else: {[], balance}
  end

  def ended(balance, input, _busy?) do
    held = List.delete(balance.held, input)
    {[], %{balance | held: held, limit: balance.limit * 2, idle: 0}}
  end

  @doc "Whether something is under way: messages that this process has not seen yet, or another process at work."
  @spec busy?() :: boolean()
  def busy? do
    Process.info(self(), :message_queue_len) != {:message_queue_len, 0} or
      :erlang.statistics(:total_active_tasks) > 1
  end

  defp ahead?(balance, input, head) do
    limit = if input in balance.held, do: div(balance.limit, 2), else: balance.limit
    Map.get(balance.newest, input, 0) - head > limit
  end

  defp change(hold, held) do
    Enum.map(hold, &{:hold, &1}) ++ Enum.map(held -- hold, &{:resume, &1})
  end
end

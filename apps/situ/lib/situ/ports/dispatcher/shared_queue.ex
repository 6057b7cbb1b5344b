defmodule Situ.Ports.Dispatcher.SharedQueue do
  @moduledoc false
  # The callbacks of a dispatcher whose messages wait in one queue for all consumers: the fields `waiting` and `count`
  # of its state. The first element of each entry in `consumers` is the key of the consumer.
  alias Situ.Message
  alias Situ.Ports.Dispatcher

  @type state :: %{
          required(:consumers) => [tuple()],
          required(:waiting) => [Message.t()],
          required(:count) => non_neg_integer(),
          optional(atom()) => term()
        }

  @spec cancel(state(), Dispatcher.key()) :: state()
  def cancel(%{consumers: consumers} = state, key),
    do: %{state | consumers: List.keydelete(consumers, key, 0)}

  @spec push(state(), [Message.t()]) :: {[], state()}
  def push(%{waiting: waiting, count: count} = state, messages),
    do: {[], %{state | waiting: waiting ++ messages, count: count + length(messages)}}

  @doc "Takes the first `n` messages."
  @spec split(state(), non_neg_integer()) :: {[Message.t()], state()}
  def split(%{waiting: waiting, count: count} = state, n) do
    {messages, waiting} = Enum.split(waiting, n)
    {messages, %{state | waiting: waiting, count: count - n}}
  end

  @spec waiting_count(state()) :: non_neg_integer()
  def waiting_count(%{count: count}), do: count

  @spec waiting_count(state(), Dispatcher.key()) :: non_neg_integer()
  def waiting_count(%{count: count}, _key), do: count

  @spec drop_unclaimed(state()) :: state()
  def drop_unclaimed(%{consumers: []} = state), do: %{state | waiting: [], count: 0}
  def drop_unclaimed(state), do: state
end

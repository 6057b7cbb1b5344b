defmodule Situ.Fusion.MessageQueue do
  @moduledoc false
  # An ordered queue of waiting messages: a list to take from, and batches that arrived later, newest first. Adding a
  # batch costs the same at any queue length. The batches are merged into the list when it is used up.
  alias Situ.Message

  @type t :: {[Message.t()], [[Message.t()]]}

  @spec new() :: t()
  def new, do: {[], []}

  @spec push(t(), [Message.t()]) :: t()
  def push({[], []}, messages), do: {messages, []}
  def push({front, rear}, messages), do: {front, [messages | rear]}

  @doc "Merges all batches into one list."
  @spec merge_batches(t()) :: t()
  def merge_batches({_front, []} = queue), do: queue
  def merge_batches({[], [messages]}), do: {messages, []}
  def merge_batches({front, rear}), do: {front ++ :lists.append(:lists.reverse(rear)), []}

  @doc "Drops `n` messages from the front."
  @spec drop_first(t(), non_neg_integer()) :: t()
  def drop_first(queue, n) do
    {messages, []} = merge_batches(queue)
    {Enum.drop(messages, n), []}
  end

  @doc """
  Takes the messages up to and including `time`, and returns the rest of the queue. Later batches are searched only if
  the first list has no message after `time`.
  """
  @spec take_until(t(), Situ.Time.t()) :: {[Message.t()], t()}
  def take_until({front, rear}, time) do
    case split_until(front, time, []) do
      {taken, []} when rear != [] ->
        {later, []} = merge_batches({[], rear})
        {more, remaining} = split_until(later, time, [])
        {taken ++ more, {remaining, []}}

      {taken, later} ->
        {taken, {later, rear}}
    end
  end

  @doc "Returns the sequence id of the first message."
  @spec head_id(t()) :: non_neg_integer() | nil
  def head_id({[%{sequence_id: id} | _], _rear}), do: id
  def head_id({[], []}), do: nil
  def head_id({[], rear}), do: rear |> List.last() |> hd() |> Map.fetch!(:sequence_id)

  @spec message_count(t()) :: non_neg_integer()
  def message_count({front, rear}), do: length(front) + Enum.reduce(rear, 0, &(length(&1) + &2))

  @doc "Returns the number of messages beyond `max`. `newest` is the sequence id of the last message."
  # Ids increase by at least one, so a span of ids within the limit needs no counting.
  @spec excess_count(t(), non_neg_integer(), pos_integer() | nil) :: non_neg_integer()
  def excess_count(_queue, _newest, nil), do: 0

  def excess_count(queue, newest, max) do
    case head_id(queue) do
      nil -> 0
      head when newest - head < max -> 0
      _head -> max(message_count(queue) - max, 0)
    end
  end

  @doc "Returns the last message of a list."
  @spec last_message([Message.t(), ...]) :: Message.t()
  def last_message([message]), do: message
  def last_message([_ | rest]), do: last_message(rest)

  defp split_until([%{originating_time: at} = message | rest], time, taken) when at <= time,
    do: split_until(rest, time, [message | taken])

  defp split_until(rest, _time, taken), do: {:lists.reverse(taken), rest}
end

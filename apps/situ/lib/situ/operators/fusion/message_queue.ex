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
  @spec whole(t()) :: t()
  def whole({_front, []} = queue), do: queue
  def whole({[], [messages]}), do: {messages, []}
  def whole({front, rear}), do: {front ++ :lists.append(:lists.reverse(rear)), []}

  @doc "Drops `n` messages from the front."
  @spec drop(t(), non_neg_integer()) :: t()
  def drop(queue, n) do
    {messages, []} = whole(queue)
    {Enum.drop(messages, n), []}
  end

  @doc """
  Takes the messages up to and including `time`, and returns the rest of the queue. Later batches are searched only if
  the first list has no message after `time`.
  """
  @spec take(t(), Situ.Time.t()) :: {[Message.t()], t()}
  def take({front, rear}, time) do
    case split(front, time, []) do
      {taken, []} when rear != [] ->
        {later, []} = whole({[], rear})
        {more, kept} = split(later, time, [])
        {taken ++ more, {kept, []}}

      {taken, kept} ->
        {taken, {kept, rear}}
    end
  end

  @doc "Returns the sequence id of the first message."
  @spec head(t()) :: non_neg_integer() | nil
  def head({[%{sequence_id: id} | _], _rear}), do: id
  def head({[], []}), do: nil
  def head({[], rear}), do: rear |> List.last() |> hd() |> Map.fetch!(:sequence_id)

  @spec count(t()) :: non_neg_integer()
  def count({front, rear}), do: length(front) + Enum.reduce(rear, 0, &(length(&1) + &2))

  @doc "Returns the number of messages beyond `max`. `newest` is the sequence id of the last message."
  # Ids increase by at least one, so a span of ids within the limit needs no counting.
  @spec excess(t(), non_neg_integer(), pos_integer() | nil) :: non_neg_integer()
  def excess(_queue, _newest, nil), do: 0

  def excess(queue, newest, max) do
    case head(queue) do
      nil -> 0
      head when newest - head < max -> 0
      _head -> max(count(queue) - max, 0)
    end
  end

  @doc "Returns the last message of a list."
  @spec last([Message.t(), ...]) :: Message.t()
  def last([message]), do: message
  def last([_ | rest]), do: last(rest)

  defp split([%{originating_time: at} = message | rest], time, taken) when at <= time,
    do: split(rest, time, [message | taken])

  defp split(rest, _time, taken), do: {:lists.reverse(taken), rest}
end

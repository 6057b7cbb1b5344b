defmodule Situ.Store.Envelopes do
  @moduledoc """
  Makes the envelopes of recorded messages monotonic. Pure.

  Recorded sequence ids and creation times are kept if they do not decrease. Where recordings were concatenated or
  edited, or a loop or a next version begins, ids continue from the previous ones. Where the clock was set back,
  creation times stay at the latest value.

      iex> message = %Situ.Message{data: :a, originating_time: 1, creation_time: 10, sequence_id: 1}
      iex> two = [message, %{message | originating_time: 2, creation_time: 5, sequence_id: 2}]
      iex> {messages, last} = Situ.Store.Envelopes.forward(two, {4, 8})
      iex> {Enum.map(messages, &{&1.sequence_id, &1.creation_time}), last}
      {[{5, 10}, {6, 10}], {6, 10}}
  """
  alias Situ.Message

  @typedoc "The latest sequence id and creation time."
  @type last :: {integer(), Situ.Time.t()}

  @doc "Returns the value of `last` before the first message."
  @spec none() :: last()
  def none, do: {0, -0x7FFFFFFFFFFFFFFF}

  @doc "Returns the messages with ids and creation times that continue after `last`, and the new `last`."
  @spec forward([Message.t()], last()) :: {[Message.t()], last()}
  def forward(messages, {sequence, creation} = last) do
    case in_order(messages, sequence, creation) do
      {:ok, last} -> {messages, last}
      :error -> Enum.map_reduce(messages, last, &straighten/2)
    end
  end

  defp in_order([%{sequence_id: id, creation_time: time} | rest], last, creation)
       when id > last and time >= creation,
       do: in_order(rest, id, time)

  defp in_order([], last, creation), do: {:ok, {last, creation}}
  defp in_order(_, _, _), do: :error

  defp straighten(message, {last, creation}) do
    id = if message.sequence_id > last, do: message.sequence_id, else: last + 1
    time = max(message.creation_time, creation)
    {%{message | sequence_id: id, creation_time: time}, {id, time}}
  end
end

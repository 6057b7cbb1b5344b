defmodule Situ.Store.Envelopes do
  @moduledoc false
  # Makes the envelopes of recorded messages monotonic. Pure.
  #
  # Recorded sequence ids and creation times are kept if they do not decrease. Where recordings
  # were concatenated or edited, a loop starts over, or the next version begins, ids continue from
  # the previous ones. Where the clock was set back, creation times stay at the latest value.
  alias Situ.Message

  @typedoc "The latest sequence id and creation time."
  @type last :: {integer(), Situ.Time.t()}

  @doc "Returns the value of `last` before the first message."
  @spec initial_envelope() :: last()
  def initial_envelope, do: {0, -0x7FFFFFFFFFFFFFFF}

  @doc """
  Returns the messages with ids and creation times that continue after `last`, and the new `last`.

      iex> message = %Situ.Message{data: :a, originating_time: 1, creation_time: 10, sequence_id: 1}
      iex> two = [message, %{message | originating_time: 2, creation_time: 5, sequence_id: 2}]
      iex> {messages, last} = Situ.Store.Envelopes.make_monotonic(two, {4, 8})
      iex> {Enum.map(messages, &{&1.sequence_id, &1.creation_time}), last}
      {[{5, 10}, {6, 10}], {6, 10}}
  """
  @spec make_monotonic([Message.t()], last()) :: {[Message.t()], last()}
  def make_monotonic(messages, {sequence, creation} = last) do
    case check_order(messages, sequence, creation) do
      {:ok, last} -> {messages, last}
      :error -> Enum.map_reduce(messages, last, &raise_envelope/2)
    end
  end

  defp check_order([%{sequence_id: id, creation_time: time} | rest], last, creation)
       when id > last and time >= creation,
       do: check_order(rest, id, time)

  defp check_order([], last, creation), do: {:ok, {last, creation}}
  defp check_order(_, _, _), do: :error

  defp raise_envelope(message, {last, creation}) do
    id = if message.sequence_id > last, do: message.sequence_id, else: last + 1
    time = max(message.creation_time, creation)
    {%{message | sequence_id: id, creation_time: time}, {id, time}}
  end
end

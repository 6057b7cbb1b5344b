defmodule Situ.Message do
  @moduledoc """
  One message of a stream: the data and its envelope.

    * `originating_time`: when the event happened in the world; strictly increasing within a stream.
    * `creation_time`: when this message was created; `creation_time - originating_time` is its latency.
    * `sequence_id`: 1, 2, 3 ... per output; a gap at an input means that messages were dropped.
    * `source_id`: the output that emitted the message, unique within its pipeline.

      iex> message = %Situ.Message{data: 42, originating_time: 10, creation_time: 13, sequence_id: 1, source_id: 7}
      iex> Situ.Message.latency(message)
      3
  """

  @enforce_keys [:data, :originating_time]
  defstruct [:data, :originating_time, creation_time: 0, sequence_id: 0, source_id: 0]

  @type t(data) :: %__MODULE__{
          data: data,
          originating_time: Situ.Time.t(),
          creation_time: Situ.Time.t(),
          sequence_id: non_neg_integer(),
          source_id: non_neg_integer()
        }
  @type t :: t(term())

  @doc "Returns creation time minus originating time, in nanoseconds."
  @spec latency(t()) :: Situ.Time.duration()
  def latency(%__MODULE__{} = message), do: message.creation_time - message.originating_time

  @doc """
  Returns the size of the data in bytes: the byte size of binaries, images and audio, and the external term format
  size of everything else. The latter traverses the term, which is expensive for large ones.

      iex> Situ.Message.data_size(%Situ.Message{data: <<1, 2, 3>>, originating_time: 0})
      3
      iex> Situ.Message.data_size(%Situ.Message{data: {:a, 1.5}, originating_time: 0}) > 8
      true
  """
  @spec data_size(t()) :: non_neg_integer()
  def data_size(%__MODULE__{data: bytes}) when is_binary(bytes), do: byte_size(bytes)
  def data_size(%__MODULE__{data: %{data: bytes}}) when is_binary(bytes), do: byte_size(bytes)
  def data_size(%__MODULE__{data: data}), do: :erlang.external_size(data)

  defimpl Inspect do
    import Inspect.Algebra

    # Small times count from a start, as in tests; others are since 1970.
    @year 365 * 86_400_000_000_000

    # The data is shortened, because a message may hold megabytes.
    def inspect(message, opts) do
      data = to_doc(message.data, %{opts | limit: 10, printable_limit: 60})
      concat(["#Situ.Message<", data, " at #{format_time(message.originating_time)}>"])
    end

    defp format_time(time) when is_integer(time) and abs(time) >= @year,
      do: Situ.Time.to_iso8601(time)

    defp format_time(time) when is_integer(time), do: "#{time} ns"
    defp format_time(time), do: Kernel.inspect(time)
  end
end

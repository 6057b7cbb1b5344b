defmodule Situ.Cluster.MessageBatch do
  @moduledoc false
  # Messages of one stream, on the way to other parts and into the log. They are packed once for all recipients. Small
  # data is packed into a binary, which processes share and distribution copies unchanged. Large data (images) is not
  # packed, since packing would copy it. Pure.
  alias Situ.Message

  @large 1_024

  @enforce_keys [:first, :last, :time, :made, :bytes, :body]
  defstruct @enforce_keys

  @typedoc """
  `first`, `last`: sequence ids, without gaps in between; `time`, `made`: originating and creation time of the last
  message; `body`: rows of originating time, creation time and data, packed or not.
  """
  @type row :: {Situ.Time.t(), Situ.Time.t(), term()}
  @type body :: binary() | [row()]
  @type t :: %__MODULE__{
          first: pos_integer(),
          last: pos_integer(),
          time: Situ.Time.t(),
          made: Situ.Time.t(),
          bytes: non_neg_integer(),
          body: body()
        }

  @doc "Builds a batch from rows, newest first; the newest row has sequence id `last`."
  @spec new(nonempty_list(row()), pos_integer()) :: t()
  def new([{time, made, data} | _] = rows, last) do
    n = length(rows)
    weight = :erlang.external_size(data)
    rows = :lists.reverse(rows)
    # Only the newest message is measured, since measuring each would cost too much.
    body = if weight < @large, do: :erlang.term_to_binary(rows), else: rows
    bytes = if is_binary(body), do: byte_size(body), else: n * weight
    %__MODULE__{first: last - n + 1, last: last, time: time, made: made, bytes: bytes, body: body}
  end

  @doc "Builds a batch from messages with sequence ids, oldest first."
  @spec pack_messages(nonempty_list(Message.t())) :: t()
  def pack_messages([first | _] = messages) do
    rows = for m <- messages, do: {m.originating_time, m.creation_time, m.data}
    new(:lists.reverse(rows), first.sequence_id + length(rows) - 1)
  end

  @spec count_messages(t()) :: pos_integer()
  def count_messages(%__MODULE__{first: first, last: last}), do: last - first + 1

  @spec to_messages(t()) :: [Message.t()]
  def to_messages(%__MODULE__{first: first, body: body}),
    do: body |> unpack_rows() |> rows_to_messages(first)

  @doc "Converts rows to messages; the first message has sequence id `first`."
  @spec rows_to_messages([row()], pos_integer()) :: [Message.t()]
  def rows_to_messages([], _first), do: []

  def rows_to_messages([{time, made, data} | rest], first) do
    message = %Message{
      data: data,
      originating_time: time,
      creation_time: made,
      sequence_id: first,
      source_id: 0
    }

    [message | rows_to_messages(rest, first + 1)]
  end

  @doc "Unpacks a body, which must come from a node of this cluster: by distribution, or under the cluster's seal."
  @spec unpack_rows(body()) :: [row()]
  def unpack_rows(body) when is_binary(body), do: :erlang.binary_to_term(body)
  def unpack_rows(body) when is_list(body), do: body

  @doc "Returns a batch of the messages after sequence id `last`, or `nil` if there are none."
  @spec take_after(t(), non_neg_integer()) :: t() | nil
  def take_after(%__MODULE__{first: first} = batch, last) when last < first, do: batch
  def take_after(%__MODULE__{last: end_id}, last) when last >= end_id, do: nil

  def take_after(%__MODULE__{} = batch, last),
    do: batch |> to_messages() |> Enum.drop(last - batch.first + 1) |> pack_messages()

  @doc "Splits a batch of at least two messages into two."
  @spec split_in_half(t()) :: {t(), t()}
  def split_in_half(%__MODULE__{first: first, last: last} = batch) when last > first do
    {head, tail} = batch |> to_messages() |> Enum.split(div(last - first + 1, 2))
    {pack_messages(head), pack_messages(tail)}
  end
end

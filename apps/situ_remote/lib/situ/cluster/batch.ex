defmodule Situ.Cluster.Batch do
  @moduledoc false
  # Messages of one stream on their way to other parts and into the log: packed once, for all of them. Small data is
  # bytes from there on, which processes share and distribution copies as they are; large data (pictures) stays as it
  # is, since packing would copy it. Pure.
  alias Situ.Message

  @large 1_024

  @enforce_keys [:first, :last, :time, :made, :bytes, :body]
  defstruct @enforce_keys

  @typedoc """
  `first`, `last`: sequence ids, without gaps between; `time`, `made`: originating and creation time of the last
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

  @doc "From rows, newest first; the newest has sequence id `last`."
  @spec new(nonempty_list(row()), pos_integer()) :: t()
  def new([{time, made, data} | _] = rows, last) do
    n = length(rows)
    weight = :erlang.external_size(data)
    rows = :lists.reverse(rows)
    # One is weighed for all.
    body = if weight < @large, do: :erlang.term_to_binary(rows), else: rows
    bytes = if is_binary(body), do: byte_size(body), else: n * weight
    %__MODULE__{first: last - n + 1, last: last, time: time, made: made, bytes: bytes, body: body}
  end

  @doc "From messages, oldest first, with their sequence ids."
  @spec pack(nonempty_list(Message.t())) :: t()
  def pack([first | _] = messages) do
    rows = for m <- messages, do: {m.originating_time, m.creation_time, m.data}
    new(:lists.reverse(rows), first.sequence_id + length(rows) - 1)
  end

  @spec count(t()) :: pos_integer()
  def count(%__MODULE__{first: first, last: last}), do: last - first + 1

  @spec messages(t()) :: [Message.t()]
  def messages(%__MODULE__{first: first, body: body}), do: body |> rows() |> messages(first)

  @doc "Messages of rows; the first has sequence id `first`."
  @spec messages([row()], pos_integer()) :: [Message.t()]
  def messages([], _first), do: []

  def messages([{time, made, data} | rest], first) do
    message = %Message{
      data: data,
      originating_time: time,
      creation_time: made,
      sequence_id: first,
      source_id: 0
    }

    [message | messages(rest, first + 1)]
  end

  @doc "Packed by a node of this cluster: it came by distribution, or under the cluster's seal."
  @spec rows(body()) :: [row()]
  def rows(body) when is_binary(body), do: :erlang.binary_to_term(body)
  def rows(body) when is_list(body), do: body

  @doc "The messages behind sequence id `last`."
  @spec behind(t(), non_neg_integer()) :: t() | nil
  def behind(%__MODULE__{first: first} = batch, last) when last < first, do: batch
  def behind(%__MODULE__{last: own}, last) when last >= own, do: nil

  def behind(%__MODULE__{} = batch, last),
    do: batch |> messages() |> Enum.drop(last - batch.first + 1) |> pack()

  @doc "Two of one, where there is more than one message."
  @spec halves(t()) :: {t(), t()}
  def halves(%__MODULE__{first: first, last: last} = batch) when last > first do
    {one, two} = batch |> messages() |> Enum.split(div(last - first + 1, 2))
    {pack(one), pack(two)}
  end
end

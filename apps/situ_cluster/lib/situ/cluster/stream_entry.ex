defmodule Situ.Cluster.StreamEntry do
  @moduledoc false
  # Converts messages of one stream to entries of the log and back. The log seals head and data together
  # (`Situ.Cluster.SealedLog`). The head describes the content:
  #
  #   First, Last   sequence ids (a fence has only Last: the position of the stream)
  #   Time, Made    originating and creation time of the last message
  #   Kind          data or fence         Epoch  of the writer's lease       Closing  the time at which the stream ends
  alias Situ.Cluster.{MessageBatch, SignedEntry}
  alias Situ.Message
  alias Situ.Cluster.Log.Entry

  @doc "Describes the position of a stream: its last message, and the time at which it closed."
  @type mark :: %{
          last: non_neg_integer(),
          time: Situ.Time.t() | nil,
          made: Situ.Time.t() | nil,
          closing: Situ.Time.t() | nil
        }

  @spec empty_mark() :: mark()
  def empty_mark, do: %{last: 0, time: nil, made: nil, closing: nil}

  @spec entry_mark(Entry.t() | nil) :: mark()
  def entry_mark(entry) do
    %{
      last: Entry.head_integer(entry, "Last", 0),
      time: Entry.head_integer(entry, "Time", nil),
      made: Entry.head_integer(entry, "Made", nil),
      closing: Entry.head_integer(entry, "Closing", nil)
    }
  end

  @doc "Builds an empty entry with the position of the stream. Once it is written, writes of older epochs are refused."
  @spec build_fence(mark(), pos_integer(), String.t()) :: Entry.t()
  def build_fence(mark, epoch, op),
    do: %Entry{op: op, head: Map.merge(encode_head(mark, epoch), %{"Kind" => "fence"})}

  @doc "Builds an entry of batches; `mark` is the position of the stream after them."
  @spec build_data([MessageBatch.t()], mark(), pos_integer(), String.t()) :: Entry.t()
  def build_data(batches, mark, epoch, op) do
    first = with [%{first: id} | _] <- batches, do: id, else: (_ -> mark.last + 1)

    head =
      Map.merge(encode_head(mark, epoch), %{"Kind" => "data", "First" => Integer.to_string(first)})

    %Entry{
      op: op,
      head: head,
      data: SignedEntry.encode_term(for(batch <- batches, do: batch.body))
    }
  end

  defp encode_head(mark, epoch) do
    pairs = [
      {"Epoch", epoch},
      {"Last", mark.last},
      {"Time", mark.time},
      {"Made", mark.made},
      {"Closing", mark.closing}
    ]

    for {key, value} <- pairs, value != nil, into: %{}, do: {key, Integer.to_string(value)}
  end

  @doc "Returns the messages of an entry that was read from a sealed log."
  @spec decode_messages(Entry.t()) :: {:ok, [Message.t()]} | {:error, Situ.Error.t()}
  def decode_messages(%Entry{data: ""}), do: {:ok, []}

  def decode_messages(%Entry{} = entry) do
    with {:ok, bodies} <- SignedEntry.decode_term(entry) do
      rows = Enum.flat_map(bodies, &MessageBatch.unpack_rows/1)
      {:ok, MessageBatch.rows_to_messages(rows, Entry.head_integer(entry, "First", 1))}
    end
  end
end

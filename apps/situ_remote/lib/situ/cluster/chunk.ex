defmodule Situ.Cluster.Chunk do
  @moduledoc false
  # Messages of one stream as entries of the log, and back. The log seals head and data together
  # (`Situ.Cluster.SealedLog`). The head says what is in it:
  #
  #   First, Last   sequence ids (a fence has Last alone: where the stream stands)
  #   Time, Made    originating and creation time of the last message
  #   Kind          data or fence         Epoch  of the writer's lease       Closing  the time at which the stream ends
  alias Situ.Cluster.{Batch, Seal}
  alias Situ.Message
  alias Situ.Remote.Log.Entry

  @doc "Where a stream stands: its last message, and when it closed."
  @type mark :: %{
          last: non_neg_integer(),
          time: Situ.Time.t() | nil,
          made: Situ.Time.t() | nil,
          closing: Situ.Time.t() | nil
        }

  @spec start() :: mark()
  def start, do: %{last: 0, time: nil, made: nil, closing: nil}

  @spec mark(Entry.t() | nil) :: mark()
  def mark(entry) do
    %{
      last: Entry.integer(entry, "Last", 0),
      time: Entry.integer(entry, "Time", nil),
      made: Entry.integer(entry, "Made", nil),
      closing: Entry.integer(entry, "Closing", nil)
    }
  end

  @doc "An empty entry that says where the stream stands: writes of older epochs are refused from here on."
  @spec fence(mark(), pos_integer(), String.t()) :: Entry.t()
  def fence(mark, epoch, op),
    do: %Entry{op: op, head: Map.merge(head(mark, epoch), %{"Kind" => "fence"})}

  @doc "Batches, behind which the stream stands at `mark`."
  @spec data([Batch.t()], mark(), pos_integer(), String.t()) :: Entry.t()
  def data(batches, mark, epoch, op) do
    first = with [%{first: id} | _] <- batches, do: id, else: (_ -> mark.last + 1)
    head = Map.merge(head(mark, epoch), %{"Kind" => "data", "First" => Integer.to_string(first)})
    %Entry{op: op, head: head, data: Seal.encode_term(for(batch <- batches, do: batch.body))}
  end

  defp head(mark, epoch) do
    pairs = [
      {"Epoch", epoch},
      {"Last", mark.last},
      {"Time", mark.time},
      {"Made", mark.made},
      {"Closing", mark.closing}
    ]

    for {key, value} <- pairs, value != nil, into: %{}, do: {key, Integer.to_string(value)}
  end

  @doc "The messages of an entry that was read from a sealed log."
  @spec messages(Entry.t()) :: {:ok, [Message.t()]} | {:error, Situ.Error.t()}
  def messages(%Entry{data: ""}), do: {:ok, []}

  def messages(%Entry{} = entry) do
    with {:ok, bodies} <- Seal.decode_term(entry) do
      rows = Enum.flat_map(bodies, &Batch.rows/1)
      {:ok, Batch.messages(rows, Entry.integer(entry, "First", 1))}
    end
  end
end

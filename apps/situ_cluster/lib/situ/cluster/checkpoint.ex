defmodule Situ.Cluster.Checkpoint do
  @moduledoc false
  # Stores the checkpoints of a part in two keys of the log, written alternately, so that the previous one stays
  # intact if writing the next one fails. `current` is the newest checkpoint that the log supports: for every stream,
  # the log contains all messages that the checkpoint builds on.
  alias Situ.Cluster.SignedEntry
  alias Situ.Error
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry

  @slots 2

  @enforce_keys [:key]
  defstruct [:key, :current, number: 0, seqs: %{}]

  @typedoc """
  `base`: the sequence ids that the log must contain for the checkpoint to be valid; `pending`: the later outputs of
  the part that the checkpoint itself contains, by stream.
  """
  @type current :: %{
          memories: map() | :done,
          base: %{String.t() => non_neg_integer()},
          pending: %{String.t() => {[Situ.Message.t()], map()}}
        }
  @type t :: %__MODULE__{
          key: String.t(),
          current: current() | nil,
          number: non_neg_integer(),
          seqs: %{non_neg_integer() => non_neg_integer()}
        }

  @doc "Takes over the checkpoints for `epoch`; from now on, writes of an older owner are refused."
  @spec take_over(Log.t(), String.t(), pos_integer(), map()) :: {:ok, t()} | {:error, Error.t()}
  def take_over(log, key, epoch, marks) do
    Enum.reduce_while(0..(@slots - 1), {:ok, %__MODULE__{key: key}}, fn slot, {:ok, checkpoint} ->
      case take_slot(log, key, slot, epoch) do
        {:ok, seq, entry} -> {:cont, {:ok, prefer_newer(checkpoint, slot, seq, entry, marks)}}
        error -> {:halt, error}
      end
    end)
  end

  defp take_slot(log, key, slot, epoch) do
    subject = {:key, "#{key}.#{slot}"}

    with {:ok, last} <- Log.fetch_last(log, subject) do
      if Entry.head_integer(last, "Epoch", 0) > epoch do
        {:error, refused_error(key)}
      else
        entry = last || %Entry{op: ""}
        head = Map.put(entry.head, "Epoch", Integer.to_string(epoch))
        claim = %Entry{op: "#{key}.#{slot}.take.#{epoch}", head: head, data: entry.data}

        case Log.append(log, subject, if(last, do: last.seq, else: 0), claim) do
          {:ok, seq} -> {:ok, seq, entry}
          {:refused, _} -> take_slot(log, key, slot, epoch)
          error -> error
        end
      end
    end
  end

  defp prefer_newer(checkpoint, slot, seq, entry, marks) do
    checkpoint = %{checkpoint | seqs: Map.put(checkpoint.seqs, slot, seq)}
    number = Entry.head_integer(entry, "Number", 0)

    with true <- number > checkpoint.number,
         {:ok, current} <- SignedEntry.decode_term(entry),
         true <- supported?(current, marks) do
      %{checkpoint | current: current, number: number}
    else
      _ -> checkpoint
    end
  end

  defp supported?(%{base: base}, marks),
    do: Enum.all?(base, fn {name, last} -> last <= Map.get(marks, name, 0) end)

  @doc "Returns the component states that the part resumes from."
  @spec saved_memories(t()) :: map() | nil | :done
  def saved_memories(%__MODULE__{current: nil}), do: nil
  def saved_memories(%__MODULE__{current: %{memories: memories}}), do: memories

  @doc "Writes the next checkpoint."
  @spec write_next(t(), Log.t(), pos_integer(), current()) :: {:ok, t()} | {:error, Error.t()}
  def write_next(%__MODULE__{} = checkpoint, log, epoch, current) do
    number = checkpoint.number + 1
    slot = rem(number, @slots)

    entry = %Entry{
      op: "#{checkpoint.key}.#{epoch}.#{number}",
      head: %{"Epoch" => Integer.to_string(epoch), "Number" => Integer.to_string(number)},
      data: SignedEntry.encode_term(current)
    }

    case Log.append(log, {:key, "#{checkpoint.key}.#{slot}"}, checkpoint.seqs[slot], entry) do
      {:ok, seq} ->
        seqs = Map.put(checkpoint.seqs, slot, seq)
        # The pending messages will be in the log soon, so this copy need not keep them.
        {:ok, %{checkpoint | number: number, seqs: seqs, current: %{current | pending: %{}}}}

      {:refused, _} ->
        {:error, refused_error(checkpoint.key)}

      error ->
        error
    end
  end

  defp refused_error(key) do
    Error.new(:refused, "the log refuses a checkpoint (#{key})",
      why: "another node has taken the part over"
    )
  end
end

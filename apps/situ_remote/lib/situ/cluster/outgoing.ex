defmodule Situ.Cluster.Outgoing do
  @moduledoc false
  # One stream that leaves a part, as its publisher knows it. Pure, but for `trim/3`.
  #
  #   mark      behind the last message that was handed over      stored   behind the last one in the log
  #   pending   batches that nobody has begun to write yet, newest first
  #   tail      the last batches that may be seen by readers, newest first
  #   policies  how each part reads it; with `direct` the log has no messages of it, only where it was taken over and
  #             when it closed
  # The batches kept are bounded by number and by size: a picture is larger than a number.
  alias Situ.Cluster.{Batch, Chunk}
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry

  @tail 16_384
  @tail_bytes 16 * 1024 * 1024
  @full 20_000
  @full_bytes 8 * 1024 * 1024

  @enforce_keys [:name, :subject]
  defstruct [
    :name,
    :subject,
    seq: 0,
    mark: nil,
    stored: nil,
    pending: [],
    count: 0,
    bytes: 0,
    tail: [],
    tail_count: 0,
    tail_bytes: 0,
    direct: false,
    policies: %{},
    handed: nil,
    busy: false
  ]

  @type t :: %__MODULE__{}

  @spec new(String.t(), String.t(), map()) :: t()
  def new(name, deployment, way \\ %{}) do
    %__MODULE__{
      name: name,
      subject: {:stream, deployment <> "." <> name},
      mark: Chunk.start(),
      stored: Chunk.start(),
      handed: Chunk.start(),
      direct: Map.get(way, :direct, false),
      policies: Map.get(way, :policies, %{})
    }
  end

  @doc """
  Takes messages over: those that it has had before are passed over (a part that was started again repeats them),
  the others get the next sequence ids; creation times do not go back, whatever the clock of this machine says.
  """
  @spec add(t(), [Situ.Message.t()]) :: {Batch.t() | nil, t()}
  def add(%__MODULE__{mark: mark} = out, messages) do
    case fresh(messages, mark, []) do
      {[], _} ->
        {nil, out}

      {rows, mark} ->
        batch = Batch.new(rows, mark.last)
        {batch, wait(%{out | mark: mark}, batch)}
    end
  end

  defp fresh([], mark, rows), do: {rows, mark}

  defp fresh([message | rest], mark, rows) do
    %{originating_time: time, creation_time: made} = message

    if mark.closing != nil or (mark.time != nil and time <= mark.time) do
      fresh(rest, mark, rows)
    else
      made = if mark.made == nil or made > mark.made, do: made, else: mark.made
      mark = %{mark | last: mark.last + 1, time: time, made: made}
      fresh(rest, mark, [{time, made, message.data} | rows])
    end
  end

  defp wait(%{direct: true} = out, _batch), do: out

  defp wait(out, batch) do
    %{
      out
      | pending: [batch | out.pending],
        count: out.count + Batch.count(batch),
        bytes: out.bytes + batch.bytes
    }
  end

  @doc "Whether more is pending than should be."
  @spec full?(t()) :: boolean()
  def full?(%__MODULE__{count: count, bytes: bytes}), do: count >= @full or bytes >= @full_bytes

  @doc "The stream ends."
  @spec close(t(), Situ.Time.t()) :: t()
  def close(%__MODULE__{mark: %{closing: nil} = mark} = out, time),
    do: %{out | mark: %{mark | closing: time}}

  def close(out, _time), do: out

  @doc "Whether there is something to be written. Of a direct stream that is its end."
  @spec pending?(t()) :: boolean()
  def pending?(%__MODULE__{direct: true} = out),
    do: out.mark.closing != nil and out.handed.closing == nil

  def pending?(%__MODULE__{} = out), do: out.mark != out.handed

  @doc "Where it stands when it is taken over."
  @spec begin(t(), Chunk.mark()) :: t()
  def begin(%__MODULE__{} = out, mark), do: %{out | mark: mark, stored: mark, handed: mark}

  @doc "The log has it up to `mark`, by entry `seq`."
  @spec stored(t(), Chunk.mark(), pos_integer()) :: t()
  def stored(%__MODULE__{} = out, mark, seq),
    do: %{out | stored: mark, seq: seq, busy: mark != out.handed}

  @doc "Takes what is to be written, oldest first."
  @spec take(t()) :: {{[Batch.t()], Chunk.mark()}, t()}
  def take(%__MODULE__{} = out) do
    taken = {Enum.reverse(out.pending), out.mark}
    {taken, %{out | pending: [], count: 0, bytes: 0, handed: out.mark, busy: true}}
  end

  @doc "Readers may see these."
  @spec show(t(), Batch.t()) :: t()
  def show(%__MODULE__{} = out, %Batch{} = batch) do
    {count, bytes} = {out.tail_count + Batch.count(batch), out.tail_bytes + batch.bytes}
    trim(%{out | tail: [batch | out.tail], tail_count: count, tail_bytes: bytes})
  end

  # Looked at once in a while only: what is left is the last part of it, and all that is not stored yet.
  defp trim(%{tail_count: count, tail_bytes: bytes} = out)
       when count > 2 * @tail or bytes > 2 * @tail_bytes do
    # Integers are smaller than atoms: of a direct stream everything may go.
    stored = if out.direct, do: :all, else: out.stored.last
    {kept, count, bytes} = keep(out.tail, stored, [], {0, 0})
    %{out | tail: kept, tail_count: count, tail_bytes: bytes}
  end

  defp trim(out), do: out

  defp keep([%{last: last} | _], stored, kept, {count, bytes})
       when (count >= @tail or bytes >= @tail_bytes) and last <= stored,
       do: {Enum.reverse(kept), count, bytes}

  defp keep([batch | rest], stored, kept, {count, bytes}),
    do: keep(rest, stored, [batch | kept], {count + Batch.count(batch), bytes + batch.bytes})

  defp keep([], _stored, kept, {count, bytes}), do: {Enum.reverse(kept), count, bytes}

  @doc """
  Takes away what the log holds of it from before `retain` ns of originating time ago. That it fails for now is no
  harm: it is tried again.
  """
  @spec trim(t(), Log.t(), pos_integer()) :: term()
  def trim(%__MODULE__{stored: %{time: nil}}, _log, _retain), do: :ok

  def trim(%__MODULE__{stored: %{time: time}} = out, log, retain) do
    # The first fence of a stream has no time: nothing was there.
    recent? = &(Entry.integer(&1, "Time", time - retain - 1) >= time - retain)

    with {:ok, [first]} <- Log.read(log, out.subject, 1, 1),
         false <- recent?.(first),
         {:ok, seq} when is_integer(seq) <- Log.find(log, out.subject, recent?),
         do: Log.trim(log, out.subject, seq)
  end

  @doc """
  The last sequence id of a direct stream that somebody has who has it up to `time`; for `nil` the one before all that
  can still be had.
  """
  @spec till(t(), Situ.Time.t() | nil) :: non_neg_integer()
  def till(%__MODULE__{tail: []} = out, _time), do: out.mark.last

  def till(%__MODULE__{tail: tail}, time) do
    had = time && Enum.find(tail, &(&1.time <= time))
    if had, do: had.last, else: List.last(tail).first - 1
  end

  @doc "The last sequence id that readers may see."
  @spec visible(t()) :: non_neg_integer()
  def visible(%__MODULE__{direct: true, mark: mark}), do: mark.last

  def visible(%__MODULE__{tail: [%{last: last} | _]} = out), do: max(last, out.stored.last)
  def visible(%__MODULE__{stored: stored}), do: stored.last

  @doc "The batch with sequence id `from`, if the tail goes back that far."
  @spec recall(t(), pos_integer()) :: {:ok, Batch.t()} | :gone
  def recall(%__MODULE__{tail: tail}, from), do: recall_in(tail, from)

  defp recall_in([%{first: first, last: last} = batch | _], from)
       when first <= from and from <= last,
       do: {:ok, batch}

  defp recall_in([_ | rest], from), do: recall_in(rest, from)
  defp recall_in([], _from), do: :gone
end

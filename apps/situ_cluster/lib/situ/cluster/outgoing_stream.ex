defmodule Situ.Cluster.OutgoingStream do
  @moduledoc false
  # Holds the state of one stream that leaves a part, for its publisher. Pure, except for `trim_log/3`.
  #
  #   mark         position after the last message received
  #   stored_mark  position after the last message in the log
  #   handed_mark  position after the last message passed to the log writer
  #   pending      batches that are not being written yet, newest first
  #   tail         the last batches that readers may see, newest first
  #   policies     the policy of each part that reads it; for a `direct` stream the log contains no messages, only the
  #                positions of takeovers and of the end
  # Both the number and the size of the stored batches are limited, since a few images can be large.
  alias Situ.Cluster.{MessageBatch, StreamEntry}
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry

  @tail 16_384
  @tail_bytes 16 * 1024 * 1024
  @max_count 20_000
  @max_bytes 8 * 1024 * 1024

  @enforce_keys [:name, :subject]
  defstruct [
    :name,
    :subject,
    seq: 0,
    mark: nil,
    stored_mark: nil,
    pending: [],
    count: 0,
    bytes: 0,
    tail: [],
    tail_count: 0,
    tail_bytes: 0,
    direct: false,
    policies: %{},
    handed_mark: nil,
    writing?: false
  ]

  @type t :: %__MODULE__{}

  @spec new(String.t(), String.t(), map()) :: t()
  def new(name, deployment, options \\ %{}) do
    %__MODULE__{
      name: name,
      subject: {:stream, deployment <> "." <> name},
      mark: StreamEntry.empty_mark(),
      stored_mark: StreamEntry.empty_mark(),
      handed_mark: StreamEntry.empty_mark(),
      direct: Map.get(options, :direct, false),
      policies: Map.get(options, :policies, %{})
    }
  end

  @doc """
  Adds messages. Skips messages that it has received before, since a restarted part repeats them. Assigns the next
  sequence ids to the others, and ensures that creation times do not decrease even if the clock of this machine does.
  """
  @spec add_messages(t(), [Situ.Message.t()]) :: {MessageBatch.t() | nil, t()}
  def add_messages(%__MODULE__{mark: mark} = stream, messages) do
    case collect_fresh(messages, mark, []) do
      {[], _} ->
        {nil, stream}

      {rows, mark} ->
        batch = MessageBatch.new(rows, mark.last)
        {batch, add_pending(%{stream | mark: mark}, batch)}
    end
  end

  defp collect_fresh([], mark, rows), do: {rows, mark}

  defp collect_fresh([message | rest], mark, rows) do
    %{originating_time: time, creation_time: creation} = message

    if mark.closing != nil or (mark.time != nil and time <= mark.time) do
      collect_fresh(rest, mark, rows)
    else
      creation = if mark.made == nil or creation > mark.made, do: creation, else: mark.made
      mark = %{mark | last: mark.last + 1, time: time, made: creation}
      collect_fresh(rest, mark, [{time, creation, message.data} | rows])
    end
  end

  defp add_pending(%{direct: true} = stream, _batch), do: stream

  defp add_pending(stream, batch) do
    %{
      stream
      | pending: [batch | stream.pending],
        count: stream.count + MessageBatch.count_messages(batch),
        bytes: stream.bytes + batch.bytes
    }
  end

  @doc "Returns whether the limit of pending messages is reached."
  @spec full?(t()) :: boolean()
  def full?(%__MODULE__{count: count, bytes: bytes}),
    do: count >= @max_count or bytes >= @max_bytes

  @doc "Closes the stream at `time`."
  @spec close(t(), Situ.Time.t()) :: t()
  def close(%__MODULE__{mark: %{closing: nil} = mark} = stream, time),
    do: %{stream | mark: %{mark | closing: time}}

  def close(stream, _time), do: stream

  @doc "Returns whether there is anything to write; for a direct stream this is only its end."
  @spec pending?(t()) :: boolean()
  def pending?(%__MODULE__{direct: true} = stream),
    do: stream.mark.closing != nil and stream.handed_mark.closing == nil

  def pending?(%__MODULE__{} = stream), do: stream.mark != stream.handed_mark

  @doc "Sets the position of the stream when it is taken over."
  @spec resume_at(t(), StreamEntry.mark()) :: t()
  def resume_at(%__MODULE__{} = stream, mark),
    do: %{stream | mark: mark, stored_mark: mark, handed_mark: mark}

  @doc "Records that the log contains the stream up to `mark`, with entry `seq`."
  @spec note_stored(t(), StreamEntry.mark(), pos_integer()) :: t()
  def note_stored(%__MODULE__{} = stream, mark, seq),
    do: %{stream | stored_mark: mark, seq: seq, writing?: mark != stream.handed_mark}

  @doc "Takes the pending batches, oldest first, and the position after them."
  @spec take_pending(t()) :: {{[MessageBatch.t()], StreamEntry.mark()}, t()}
  def take_pending(%__MODULE__{} = stream) do
    outputs = {Enum.reverse(stream.pending), stream.mark}

    {outputs,
     %{stream | pending: [], count: 0, bytes: 0, handed_mark: stream.mark, writing?: true}}
  end

  @doc "Makes a batch visible to readers."
  @spec make_visible(t(), MessageBatch.t()) :: t()
  def make_visible(%__MODULE__{} = stream, %MessageBatch{} = batch) do
    {count, bytes} =
      {stream.tail_count + MessageBatch.count_messages(batch), stream.tail_bytes + batch.bytes}

    trim_tail(%{stream | tail: [batch | stream.tail], tail_count: count, tail_bytes: bytes})
  end

  # Runs only when twice the limit is reached, and then keeps the newest batches and all unstored ones.
  defp trim_tail(%{tail_count: count, tail_bytes: bytes} = stream)
       when count > 2 * @tail or bytes > 2 * @tail_bytes do
    # Integers are smaller than atoms, so `:all` allows every batch of a direct stream to be dropped.
    stored = if stream.direct, do: :all, else: stream.stored_mark.last
    {recent, count, bytes} = keep_recent(stream.tail, stored, [], {0, 0})
    %{stream | tail: recent, tail_count: count, tail_bytes: bytes}
  end

  defp trim_tail(stream), do: stream

  defp keep_recent([%{last: last} | _], stored, recent, {count, bytes})
       when (count >= @tail or bytes >= @tail_bytes) and last <= stored,
       do: {Enum.reverse(recent), count, bytes}

  defp keep_recent([batch | rest], stored, recent, {count, bytes}),
    do:
      keep_recent(
        rest,
        stored,
        [batch | recent],
        {count + MessageBatch.count_messages(batch), bytes + batch.bytes}
      )

  defp keep_recent([], _stored, recent, {count, bytes}), do: {Enum.reverse(recent), count, bytes}

  @doc """
  Deletes the log's entries that are more than `retain` ns of originating time old. A failure does no harm, since the
  publisher tries again regularly.
  """
  @spec trim_log(t(), Log.t(), pos_integer()) :: term()
  def trim_log(%__MODULE__{stored_mark: %{time: nil}}, _log, _retain), do: :ok

  def trim_log(%__MODULE__{stored_mark: %{time: time}} = stream, log, retain) do
    # The first fence of a stream has no time, because there were no messages before it.
    recent? = &(Entry.head_integer(&1, "Time", time - retain - 1) >= time - retain)

    with {:ok, [first]} <- Log.read(log, stream.subject, 1, 1),
         false <- recent?.(first),
         {:ok, seq} when is_integer(seq) <- Log.find_position(log, stream.subject, recent?),
         do: Log.trim(log, stream.subject, seq)
  end

  @doc """
  Returns the last sequence id of a direct stream that a reader with all messages up to `time` has. For `nil`, returns
  the id before the first message that is still available.
  """
  @spec last_id_at(t(), Situ.Time.t() | nil) :: non_neg_integer()
  def last_id_at(%__MODULE__{tail: []} = stream, _time), do: stream.mark.last

  def last_id_at(%__MODULE__{tail: tail}, time) do
    seen = time && Enum.find(tail, &(&1.time <= time))
    if seen, do: seen.last, else: List.last(tail).first - 1
  end

  @doc "Returns the last sequence id that readers may see."
  @spec last_visible(t()) :: non_neg_integer()
  def last_visible(%__MODULE__{direct: true, mark: mark}), do: mark.last

  def last_visible(%__MODULE__{tail: [%{last: last} | _]} = stream),
    do: max(last, stream.stored_mark.last)

  def last_visible(%__MODULE__{stored_mark: stored}), do: stored.last

  @doc "Returns the batch that contains sequence id `from`, or `:gone` if the tail no longer contains it."
  @spec fetch_batch(t(), pos_integer()) :: {:ok, MessageBatch.t()} | :gone
  def fetch_batch(%__MODULE__{tail: tail}, from), do: find_in_tail(tail, from)

  defp find_in_tail([%{first: first, last: last} = batch | _], from)
       when first <= from and from <= last,
       do: {:ok, batch}

  defp find_in_tail([_ | rest], from), do: find_in_tail(rest, from)
  defp find_in_tail([], _from), do: :gone
end

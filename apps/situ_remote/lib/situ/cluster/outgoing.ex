defmodule Situ.Cluster.Outgoing do
  @moduledoc false
  # One stream that leaves a part, as its publisher knows it. Pure, but for `trim/3`.
  #
  #   mark      behind the last message that was handed over      stored   behind the last one in the log
  #   pending   messages that are not in the log yet, newest first
  #   tail      the last batches that may be seen by readers, newest first
  # The batches kept are bounded by number and by size: a picture is larger than a number.
  alias Situ.Cluster.Chunk
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry

  @tail 8_192
  @tail_bytes 8 * 1024 * 1024
  @full 20_000
  @full_bytes 4 * 1024 * 1024

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
    tail_bytes: 0
  ]

  @type t :: %__MODULE__{}

  @spec new(String.t(), String.t()) :: t()
  def new(name, deployment) do
    %__MODULE__{
      name: name,
      subject: {:stream, deployment <> "." <> name},
      mark: Chunk.start(),
      stored: Chunk.start()
    }
  end

  @doc """
  Takes messages over: those that it has had before are passed over (a part that was started again repeats them),
  the others get the next sequence ids; creation times do not go back, whatever the clock of this machine says.
  """
  @spec add(t(), [Situ.Message.t()]) :: {[Situ.Message.t()], t()}
  def add(%__MODULE__{mark: mark} = out, messages) do
    {fresh, mark} =
      Enum.reduce(messages, {[], mark}, fn message, {fresh, mark} ->
        if mark.closing != nil or (mark.time != nil and message.originating_time <= mark.time) do
          {fresh, mark}
        else
          made = max(message.creation_time, mark.made || message.creation_time)
          message = %{message | sequence_id: mark.last + 1, creation_time: made}
          mark = %{mark | last: mark.last + 1, time: message.originating_time, made: made}
          {[message | fresh], mark}
        end
      end)

    count = out.count + length(fresh)
    bytes = out.bytes + weight(fresh)
    pending = fresh ++ out.pending
    {Enum.reverse(fresh), %{out | mark: mark, pending: pending, count: count, bytes: bytes}}
  end

  # One is weighed for all of a batch.
  defp weight([]), do: 0
  defp weight([%{data: data} | _] = batch), do: :erlang.external_size(data) * length(batch)

  @doc "Whether more is pending than should be."
  @spec full?(t()) :: boolean()
  def full?(%__MODULE__{count: count, bytes: bytes}), do: count >= @full or bytes >= @full_bytes

  @doc "The stream ends."
  @spec close(t(), Situ.Time.t()) :: t()
  def close(%__MODULE__{mark: %{closing: nil} = mark} = out, time),
    do: %{out | mark: %{mark | closing: time}}

  def close(out, _time), do: out

  @doc "Whether there is something to be stored."
  @spec pending?(t()) :: boolean()
  def pending?(%__MODULE__{} = out), do: out.pending != [] or out.mark != out.stored

  @doc "Takes what is to be stored, oldest first."
  @spec take(t()) :: {{[Situ.Message.t()], Chunk.mark()}, t()}
  def take(%__MODULE__{} = out),
    do: {{Enum.reverse(out.pending), out.mark}, %{out | pending: [], count: 0, bytes: 0}}

  @doc "Readers may see these."
  @spec show(t(), [Situ.Message.t()]) :: t()
  def show(out, []), do: out

  def show(%__MODULE__{} = out, [first | _] = messages) do
    n = length(messages)
    bytes = weight(messages)
    batch = {first.sequence_id, first.sequence_id + n - 1, messages, bytes}
    {count, bytes} = {out.tail_count + n, out.tail_bytes + bytes}
    trim(%{out | tail: [batch | out.tail], tail_count: count, tail_bytes: bytes})
  end

  # Looked at once in a while only: what is left is the last part of it, and all that is not stored yet.
  defp trim(%{tail_count: count, tail_bytes: bytes} = out)
       when count > 2 * @tail or bytes > 2 * @tail_bytes do
    {kept, count, bytes} = keep(out.tail, out.stored.last, [], {0, 0})
    %{out | tail: kept, tail_count: count, tail_bytes: bytes}
  end

  defp trim(out), do: out

  defp keep([{_, last, _, _} | _], stored, kept, {count, bytes})
       when (count >= @tail or bytes >= @tail_bytes) and last <= stored,
       do: {Enum.reverse(kept), count, bytes}

  defp keep([{first, last, _, weight} = batch | rest], stored, kept, {count, bytes}),
    do: keep(rest, stored, [batch | kept], {count + last - first + 1, bytes + weight})

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

  @doc "The last sequence id that readers may see."
  @spec visible(t()) :: non_neg_integer()
  def visible(%__MODULE__{tail: [{_, last, _, _} | _]} = out), do: max(last, out.stored.last)
  def visible(%__MODULE__{stored: stored}), do: stored.last

  @doc "Messages from sequence id `from` on, if the tail goes back that far."
  @spec recall(t(), pos_integer()) :: {:ok, [Situ.Message.t()]} | :gone
  def recall(%__MODULE__{tail: tail}, from), do: recall_in(tail, from)

  defp recall_in([{first, last, messages, _} | _], from) when first <= from and from <= last,
    do: {:ok, Enum.drop(messages, from - first)}

  defp recall_in([_ | rest], from), do: recall_in(rest, from)
  defp recall_in([], _from), do: :gone
end

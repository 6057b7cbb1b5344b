defmodule Situ.Cluster.Readers do
  @moduledoc false
  # The subscribers of a publisher: how far each has come, how much it has asked for, and what was read out of the log
  # for one that is behind. One that may lose messages of a direct stream has a queue instead, under its policy; any
  # other reader of a direct stream misses what has left the tail.
  #
  # `keeping_up?/2` says whether a producer that can wait should: a reader that takes its messages as they are made
  # holds it, one that stands still or reads old messages out of the log does not.
  alias Situ.Cluster.{Batch, Chunk, Outgoing, Seal}
  alias Situ.Delivery
  alias Situ.Delivery.Queue
  alias Situ.Remote.Log
  alias Situ.Remote.Log.Entry
  require Logger

  # The producer waits for a reader that has so much before it, unless that has asked for nothing for so long.
  @behind 8_192
  @behind_bytes 12 * 1024 * 1024
  @patience_ms 500
  # A direct stream has no other copy.
  @direct_patience_ms 5_000
  # The size of a queue under a policy that names none.
  @queued 1_000

  defstruct by_ref: %{}, seen: MapSet.new()

  @typedoc "`seen`: the parts that have joined a stream once, `{stream, part}`."
  @type t :: %__MODULE__{by_ref: %{term() => map()}, seen: MapSet.t()}

  @doc "A new one, that has all up to sequence id `from`."
  @spec join(t(), pid(), term(), Outgoing.t(), keyword()) :: t()
  def join(%__MODULE__{} = readers, pid, ref, out, opts) do
    reader = %{
      pid: pid,
      part: opts[:reader],
      batches: opts[:batches] == true,
      ref: ref,
      name: out.name,
      last: from(out, opts),
      demand: 0,
      ahead: [],
      next: nil,
      live: out.direct,
      queue: queue(out.policies[opts[:reader]]),
      weight: 0,
      dropped: 0,
      told: false,
      asked: now(),
      monitor: Process.monitor(pid)
    }

    seen = MapSet.put(readers.seen, {out.name, opts[:reader]})
    %{readers | by_ref: Map.put(readers.by_ref, ref, reader), seen: seen}
  end

  # Who reads a direct stream numbers it itself: it knows the time of the last message that it has had.
  defp from(%{direct: true} = out, opts), do: Outgoing.till(out, opts[:time])
  defp from(_out, opts), do: Keyword.get(opts, :from, 0)

  # The part that reads has the policy's own queue: this one bounds what waits for the way there.
  defp queue(nil), do: nil

  defp queue(%Delivery{} = policy) do
    most = if policy.max_queue == :infinity, do: @queued, else: policy.max_queue
    keep = if policy.guarantee, do: [guarantee: policy.guarantee], else: []
    Queue.new(Delivery.max_queue(most, keep))
  end

  @doc "Whether all `parts` have joined the stream, now or before."
  @spec seen?(t(), Outgoing.t(), [String.t()]) :: boolean()
  def seen?(%__MODULE__{seen: seen}, out, parts),
    do: Enum.all?(parts, &MapSet.member?(seen, {out.name, &1}))

  @doc "Whether every reader has taken what was put out, but for a little; one that stands still is not waited for."
  @spec keeping_up?(t(), Outgoing.t()) :: boolean()
  def keeping_up?(%__MODULE__{by_ref: by_ref}, out),
    do:
      not Enum.any?(by_ref, fn {_, reader} -> reader.name == out.name and late?(reader, out) end)

  defp late?(%{queue: nil, live: true} = reader, out),
    do: much?(Outgoing.visible(out) - reader.last, reader.weight) and waiting?(reader, out.direct)

  defp late?(_reader, _out), do: false

  defp much?(n, weight), do: n >= @behind or n * weight >= @behind_bytes
  defp waiting?(reader, true), do: now() - reader.asked < @direct_patience_ms
  defp waiting?(reader, false), do: now() - reader.asked < @patience_ms
  defp now, do: System.monotonic_time(:millisecond)

  @doc "New messages of a direct stream, for whoever may lose them."
  @spec offer(t(), Outgoing.t(), Batch.t()) :: t()
  def offer(%__MODULE__{by_ref: by_ref} = readers, out, batch) do
    by_ref =
      Map.new(by_ref, fn {ref, reader} ->
        mine? = reader.name == out.name and reader.queue != nil
        {ref, if(mine?, do: offered(reader, batch), else: reader)}
      end)

    %{readers | by_ref: by_ref}
  end

  defp offered(%{queue: %Queue{size: 0}, demand: demand} = reader, batch) when demand > 0,
    do: give(reader, batch)

  defp offered(reader, batch) do
    {queue, dropped} = Queue.push_all(reader.queue, Batch.messages(batch))
    weighed(%{reader | queue: queue, dropped: reader.dropped + dropped}, batch)
  end

  defp weighed(reader, batch), do: %{reader | weight: div(batch.bytes, Batch.count(batch))}

  @spec ask(t(), term(), pos_integer()) :: {:ok, String.t(), t()} | :error
  def ask(%__MODULE__{by_ref: by_ref} = readers, ref, n) do
    case by_ref do
      %{^ref => reader} ->
        reader = %{reader | demand: reader.demand + n, asked: now()}
        {:ok, reader.name, %{readers | by_ref: %{by_ref | ref => reader}}}

      _ ->
        :error
    end
  end

  @spec leave(t(), term()) :: t()
  def leave(%__MODULE__{by_ref: by_ref} = readers, ref) do
    with %{^ref => reader} <- by_ref, do: Process.demonitor(reader.monitor, [:flush])
    %{readers | by_ref: Map.delete(by_ref, ref)}
  end

  @doc "Its process has ended."
  @spec gone(t(), reference()) :: t()
  def gone(%__MODULE__{by_ref: by_ref} = readers, monitor) do
    %{readers | by_ref: Map.reject(by_ref, fn {_, reader} -> reader.monitor == monitor end)}
  end

  @doc "How far each is behind, for people."
  @spec info(t()) :: [map()]
  def info(%__MODULE__{by_ref: by_ref}) do
    for {_, reader} <- by_ref,
        do: %{
          node: node(reader.pid),
          part: reader.part,
          stream: reader.name,
          last: reader.last,
          demand: reader.demand,
          dropped: reader.dropped
        }
  end

  @doc "Sends the readers of a stream what they have asked for, as far as it is there."
  @spec serve(t(), Outgoing.t(), Log.t()) :: t()
  def serve(%__MODULE__{by_ref: by_ref} = readers, out, log) do
    by_ref =
      for {ref, reader} <- by_ref,
          reader = if(reader.name == out.name, do: one(reader, out, log), else: reader),
          reader != nil,
          into: %{},
          do: {ref, reader}

    %{readers | by_ref: by_ref}
  end

  defp one(%{queue: %Queue{size: n}, demand: demand} = reader, out, log)
       when n > 0 and demand > 0 do
    {messages, _took, queue} = Queue.take(reader.queue, demand)
    %{reader | queue: queue} |> give_all(messages) |> one(out, log)
  end

  defp one(%{queue: %Queue{size: n}} = reader, _out, _log) when n > 0, do: reader

  defp one(%{queue: %Queue{}} = reader, %{stored: %{closing: nil}}, _log), do: reader

  defp one(%{queue: queue, last: last} = reader, %{stored: %{last: end_of, closing: time}}, _log)
       when time != nil and (queue != nil or last == end_of) do
    Process.demonitor(reader.monitor, [:flush])

    send(
      reader.pid,
      {:"$gen_consumer", {self(), reader.ref}, {:cancel, {:shutdown, {:closed, time}}}}
    )

    nil
  end

  defp one(%{demand: demand} = reader, _out, _log) when demand <= 0, do: reader

  defp one(%{ahead: []} = reader, out, log) do
    if reader.last >= Outgoing.visible(out) do
      reader
    else
      case Outgoing.recall(out, reader.last + 1) do
        {:ok, batch} -> %{reader | live: true} |> give(batch) |> one(out, log)
        :gone when out.direct -> reader |> miss(Outgoing.till(out, nil)) |> one(out, log)
        :gone -> %{reader | live: false} |> fetch(out, log) |> one_fetched(out, log)
      end
    end
  end

  defp one(reader, out, log) do
    {now, later} = Enum.split(reader.ahead, reader.demand)
    %{reader | ahead: later} |> give_all(now) |> one(out, log)
  end

  defp miss(reader, last),
    do: %{reader | last: last, dropped: reader.dropped + last - reader.last}

  defp one_fetched(%{ahead: []} = reader, _out, _log), do: reader
  defp one_fetched(reader, out, log), do: one(reader, out, log)

  # An inlet takes batches as they are, what it has had and what is beyond its demand included; it gives up its claim to
  # so many later. For any other consumer the rest stays in the tail.
  defp give(%{batches: true} = reader, batch),
    do: send_on(reader, batch, {:situ_batch, batch.first, batch.body})

  defp give(reader, batch) do
    messages = batch |> Batch.behind(reader.last) |> Batch.messages() |> Enum.take(reader.demand)
    reader |> weighed(batch) |> give_all(messages)
  end

  defp give_all(reader, messages),
    do: send_on(reader, %{first: nil, last: List.last(messages).sequence_id}, messages)

  defp send_on(reader, %{last: last} = batch, what) do
    send(reader.pid, {:"$gen_consumer", {self(), reader.ref}, what})
    n = if is_list(what), do: length(what), else: last - batch.first + 1
    reader = if is_list(what), do: reader, else: weighed(reader, batch)
    %{reader | demand: reader.demand - n, last: last}
  end

  # The next entry with messages that the reader lacks. After an error of the log the next request tries again.
  defp fetch(%{next: nil} = reader, out, log) do
    case Log.find(log, out.subject, &(Entry.integer(&1, "Last", 0) > reader.last)) do
      {:ok, seq} when is_integer(seq) -> fetch(%{reader | next: seq}, out, log)
      _ -> reader
    end
  end

  defp fetch(reader, out, log) do
    with {:ok, [entry]} <- Log.read(log, out.subject, reader.next, 1),
         {:ok, messages} <- Chunk.messages(entry) do
      reader = %{reader | next: entry.seq + 1}

      case Enum.drop_while(messages, &(&1.sequence_id <= reader.last)) do
        [] when entry.seq < out.seq -> fetch(reader, out, log)
        messages -> %{reader | ahead: messages}
      end
    else
      {:error, error} -> log_refusal(%{reader | next: nil}, error)
      _ -> %{reader | next: nil}
    end
  end

  # The reader gets nothing from a refused entry, and keeps asking: somebody may repair the log.
  defp log_refusal(reader, error) do
    if Seal.refusal?(error) and not reader.told,
      do: Logger.error("#{reader.part} waits for #{reader.name}: #{Exception.message(error)}")

    %{reader | told: reader.told or Seal.refusal?(error)}
  end
end

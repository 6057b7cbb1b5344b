defmodule Situ.Cluster.Subscribers do
  @moduledoc false
  # Manages the subscribers of a publisher: the position and demand of each, and the messages read from the log for a
  # slow reader. A reader of a direct stream that may lose messages has a queue with its policy instead. Any other
  # reader of a direct stream misses the messages that are no longer in the tail.
  #
  # `keeping_up?/2` returns whether the producer may continue. A reader that takes messages as they are made holds the
  # producer back; a reader that is paused or reads old messages from the log does not.
  alias Situ.Cluster.{MessageBatch, StreamEntry, OutgoingStream, SignedEntry}
  alias Situ.Delivery
  alias Situ.Delivery.Queue
  alias Situ.Cluster.Log
  alias Situ.Cluster.Log.Entry
  require Logger

  # The producer waits for a reader with this many outstanding messages, unless the reader has stopped requesting.
  @behind 8_192
  @behind_bytes 12 * 1024 * 1024
  @patience_ms 500
  # The messages of a direct stream are stored nowhere else, so the producer waits longer.
  @direct_patience_ms 5_000
  # The queue size for a policy that does not specify one.
  @queued 1_000

  defstruct by_ref: %{}, seen: MapSet.new()

  @typedoc "`seen`: the parts that have ever joined a stream, as `{stream, part}`."
  @type t :: %__MODULE__{by_ref: %{term() => map()}, seen: MapSet.t()}

  @doc "Adds a reader that already has all messages up to the sequence id `from`."
  @spec add_reader(t(), pid(), term(), OutgoingStream.t(), keyword()) :: t()
  def add_reader(%__MODULE__{} = readers, pid, ref, out, opts) do
    reader = %{
      pid: pid,
      part: opts[:reader],
      batches: opts[:batches] == true,
      ref: ref,
      name: out.name,
      last: start_id(out, opts),
      demand: 0,
      ahead: [],
      next: nil,
      live: out.direct,
      queue: build_queue(out.policies[opts[:reader]]),
      weight: 0,
      dropped: 0,
      told: false,
      asked: monotonic_ms(),
      monitor: Process.monitor(pid)
    }

    seen = MapSet.put(readers.seen, {out.name, opts[:reader]})
    %{readers | by_ref: Map.put(readers.by_ref, ref, reader), seen: seen}
  end

  # A reader of a direct stream numbers the messages itself, so its position is the time of its last message.
  defp start_id(%{direct: true} = out, opts), do: OutgoingStream.last_id_at(out, opts[:time])
  defp start_id(_out, opts), do: Keyword.get(opts, :from, 0)

  # The reading part has its own queue with the policy. This queue limits the messages that wait to be sent there.
  defp build_queue(nil), do: nil

  defp build_queue(%Delivery{} = policy) do
    most = if policy.max_queue == :infinity, do: @queued, else: policy.max_queue
    keep = if policy.guarantee, do: [guarantee: policy.guarantee], else: []
    Queue.new(Delivery.max_queue(most, keep))
  end

  @doc "Returns whether all `parts` have joined the stream at some time."
  @spec all_joined?(t(), OutgoingStream.t(), [String.t()]) :: boolean()
  def all_joined?(%__MODULE__{seen: seen}, out, parts),
    do: Enum.all?(parts, &MapSet.member?(seen, {out.name, &1}))

  @doc "Returns whether every active reader has taken nearly all messages; paused readers do not count."
  @spec keeping_up?(t(), OutgoingStream.t()) :: boolean()
  def keeping_up?(%__MODULE__{by_ref: by_ref}, out),
    do:
      not Enum.any?(by_ref, fn {_, reader} ->
        reader.name == out.name and reader_lags?(reader, out)
      end)

  defp reader_lags?(%{queue: nil, live: true} = reader, out),
    do:
      exceeds_limits?(OutgoingStream.last_visible(out) - reader.last, reader.weight) and
        within_patience?(reader, out.direct)

  defp reader_lags?(_reader, _out), do: false

  defp exceeds_limits?(n, weight), do: n >= @behind or n * weight >= @behind_bytes
  defp within_patience?(reader, true), do: monotonic_ms() - reader.asked < @direct_patience_ms
  defp within_patience?(reader, false), do: monotonic_ms() - reader.asked < @patience_ms
  defp monotonic_ms, do: System.monotonic_time(:millisecond)

  @doc "Offers new messages of a direct stream to the readers that may lose them."
  @spec offer_batch(t(), OutgoingStream.t(), MessageBatch.t()) :: t()
  def offer_batch(%__MODULE__{by_ref: by_ref} = readers, out, batch) do
    by_ref =
      Map.new(by_ref, fn {ref, reader} ->
        mine? = reader.name == out.name and reader.queue != nil
        {ref, if(mine?, do: offer_to_reader(reader, batch), else: reader)}
      end)

    %{readers | by_ref: by_ref}
  end

  defp offer_to_reader(%{queue: %Queue{size: 0}, demand: demand} = reader, batch) when demand > 0,
    do: send_batch(reader, batch)

  defp offer_to_reader(reader, batch) do
    {queue, dropped} = Queue.push_all(reader.queue, MessageBatch.to_messages(batch))
    put_weight(%{reader | queue: queue, dropped: reader.dropped + dropped}, batch)
  end

  defp put_weight(reader, batch),
    do: %{reader | weight: div(batch.bytes, MessageBatch.count_messages(batch))}

  @spec add_demand(t(), term(), pos_integer()) :: {:ok, String.t(), t()} | :error
  def add_demand(%__MODULE__{by_ref: by_ref} = readers, ref, n) do
    case by_ref do
      %{^ref => reader} ->
        reader = %{reader | demand: reader.demand + n, asked: monotonic_ms()}
        {:ok, reader.name, %{readers | by_ref: %{by_ref | ref => reader}}}

      _ ->
        :error
    end
  end

  @spec remove_reader(t(), term()) :: t()
  def remove_reader(%__MODULE__{by_ref: by_ref} = readers, ref) do
    with %{^ref => reader} <- by_ref, do: Process.demonitor(reader.monitor, [:flush])
    %{readers | by_ref: Map.delete(by_ref, ref)}
  end

  @doc "Removes a reader whose process has ended."
  @spec remove_ended(t(), reference()) :: t()
  def remove_ended(%__MODULE__{by_ref: by_ref} = readers, monitor) do
    %{readers | by_ref: Map.reject(by_ref, fn {_, reader} -> reader.monitor == monitor end)}
  end

  @doc "Returns the position of each reader, for display."
  @spec reader_positions(t()) :: [map()]
  def reader_positions(%__MODULE__{by_ref: by_ref}) do
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

  @doc "Sends the readers of a stream the messages that they have requested, as far as these are available."
  @spec serve_stream(t(), OutgoingStream.t(), Log.t()) :: t()
  def serve_stream(%__MODULE__{by_ref: by_ref} = readers, out, log) do
    by_ref =
      for {ref, reader} <- by_ref,
          reader = if(reader.name == out.name, do: serve_reader(reader, out, log), else: reader),
          reader != nil,
          into: %{},
          do: {ref, reader}

    %{readers | by_ref: by_ref}
  end

  defp serve_reader(%{queue: %Queue{size: n}, demand: demand} = reader, out, log)
       when n > 0 and demand > 0 do
    {messages, _took, queue} = Queue.take(reader.queue, demand)
    %{reader | queue: queue} |> send_messages(messages) |> serve_reader(out, log)
  end

  defp serve_reader(%{queue: %Queue{size: n}} = reader, _out, _log) when n > 0, do: reader

  defp serve_reader(%{queue: %Queue{}} = reader, %{stored: %{closing: nil}}, _log), do: reader

  defp serve_reader(
         %{queue: queue, last: last} = reader,
         %{stored: %{last: end_of, closing: time}},
         _log
       )
       when time != nil and (queue != nil or last == end_of) do
    Process.demonitor(reader.monitor, [:flush])

    send(
      reader.pid,
      {:"$gen_consumer", {self(), reader.ref}, {:cancel, {:shutdown, {:closed, time}}}}
    )

    nil
  end

  defp serve_reader(%{demand: demand} = reader, _out, _log) when demand <= 0, do: reader

  defp serve_reader(%{ahead: []} = reader, out, log) do
    if reader.last >= OutgoingStream.last_visible(out) do
      reader
    else
      case OutgoingStream.fetch_batch(out, reader.last + 1) do
        {:ok, batch} ->
          %{reader | live: true} |> send_batch(batch) |> serve_reader(out, log)

        :gone when out.direct ->
          reader |> skip_missed(OutgoingStream.last_id_at(out, nil)) |> serve_reader(out, log)

        :gone ->
          %{reader | live: false} |> fetch_entry(out, log) |> serve_fetched(out, log)
      end
    end
  end

  defp serve_reader(reader, out, log) do
    {now, later} = Enum.split(reader.ahead, reader.demand)
    %{reader | ahead: later} |> send_messages(now) |> serve_reader(out, log)
  end

  defp skip_missed(reader, last),
    do: %{reader | last: last, dropped: reader.dropped + last - reader.last}

  defp serve_fetched(%{ahead: []} = reader, _out, _log), do: reader
  defp serve_fetched(reader, out, log), do: serve_reader(reader, out, log)

  # An inlet accepts whole batches, including messages that it already has or that exceed its demand, which it reduces
  # accordingly. For any other consumer, the rest of a batch stays in the tail.
  defp send_batch(%{batches: true} = reader, batch),
    do: send_to_reader(reader, batch, {:situ_batch, batch.first, batch.body})

  defp send_batch(reader, batch) do
    messages =
      batch
      |> MessageBatch.take_after(reader.last)
      |> MessageBatch.to_messages()
      |> Enum.take(reader.demand)

    reader |> put_weight(batch) |> send_messages(messages)
  end

  defp send_messages(reader, messages),
    do: send_to_reader(reader, %{first: nil, last: List.last(messages).sequence_id}, messages)

  defp send_to_reader(reader, %{last: last} = batch, what) do
    send(reader.pid, {:"$gen_consumer", {self(), reader.ref}, what})
    n = if is_list(what), do: length(what), else: last - batch.first + 1
    reader = if is_list(what), do: reader, else: put_weight(reader, batch)
    %{reader | demand: reader.demand - n, last: last}
  end

  # Reads the next entry with messages that the reader lacks. After an error of the log, the next request tries again.
  defp fetch_entry(%{next: nil} = reader, out, log) do
    case Log.find_position(log, out.subject, &(Entry.head_integer(&1, "Last", 0) > reader.last)) do
      {:ok, seq} when is_integer(seq) -> fetch_entry(%{reader | next: seq}, out, log)
      _ -> reader
    end
  end

  defp fetch_entry(reader, out, log) do
    with {:ok, [entry]} <- Log.read(log, out.subject, reader.next, 1),
         {:ok, messages} <- StreamEntry.decode_messages(entry) do
      reader = %{reader | next: entry.seq + 1}

      case Enum.drop_while(messages, &(&1.sequence_id <= reader.last)) do
        [] when entry.seq < out.seq -> fetch_entry(reader, out, log)
        messages -> %{reader | ahead: messages}
      end
    else
      {:error, error} -> log_refusal(%{reader | next: nil}, error)
      _ -> %{reader | next: nil}
    end
  end

  # The reader gets no messages from a refused entry and tries again, since the log may be repaired.
  defp log_refusal(reader, error) do
    if SignedEntry.refusal?(error) and not reader.told,
      do: Logger.error("#{reader.part} waits for #{reader.name}: #{Exception.message(error)}")

    %{reader | told: reader.told or SignedEntry.refusal?(error)}
  end
end

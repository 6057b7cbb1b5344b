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
  @max_messages 8_192
  @max_bytes 12 * 1024 * 1024
  @patience_ms 500
  # The messages of a direct stream are stored nowhere else, so the producer waits longer.
  @direct_patience_ms 5_000
  # The queue size for a policy that does not specify one.
  @default_queue 1_000

  defstruct by_ref: %{}, joined: MapSet.new()

  @typedoc "`joined`: the parts that have ever joined a stream, as `{stream, part}`."
  @type t :: %__MODULE__{by_ref: %{term() => map()}, joined: MapSet.t()}

  @doc "Adds a reader that already has all messages up to the sequence id `from`."
  @spec add_reader(t(), pid(), term(), OutgoingStream.t(), keyword()) :: t()
  def add_reader(%__MODULE__{} = readers, pid, ref, stream, opts) do
    reader = %{
      pid: pid,
      part: opts[:reader],
      batches: opts[:batches] == true,
      ref: ref,
      name: stream.name,
      last: start_id(stream, opts),
      demand: 0,
      fetched: [],
      next_seq: nil,
      live: stream.direct,
      queue: build_queue(stream.policies[opts[:reader]]),
      weight: 0,
      dropped: 0,
      refusal_logged?: false,
      asked_ms: monotonic_ms(),
      monitor: Process.monitor(pid)
    }

    joined = MapSet.put(readers.joined, {stream.name, opts[:reader]})
    %{readers | by_ref: Map.put(readers.by_ref, ref, reader), joined: joined}
  end

  # A reader of a direct stream numbers the messages itself, so its position is the time of its last message.
  defp start_id(%{direct: true} = stream, opts),
    do: OutgoingStream.last_id_at(stream, opts[:time])

  defp start_id(_out, opts), do: Keyword.get(opts, :from, 0)

  # The reading part has its own queue with the policy. This queue limits the messages that wait to be sent there.
  defp build_queue(nil), do: nil

  defp build_queue(%Delivery{} = policy) do
    max = if policy.max_queue == :infinity, do: @default_queue, else: policy.max_queue
    options = if policy.guarantee, do: [guarantee: policy.guarantee], else: []
    Queue.new(Delivery.max_queue(max, options))
  end

  @doc "Returns whether all `parts` have joined the stream at some time."
  @spec all_joined?(t(), OutgoingStream.t(), [String.t()]) :: boolean()
  def all_joined?(%__MODULE__{joined: joined}, stream, parts),
    do: Enum.all?(parts, &MapSet.member?(joined, {stream.name, &1}))

  @doc "Returns whether every active reader has taken nearly all messages; paused readers do not count."
  @spec keeping_up?(t(), OutgoingStream.t()) :: boolean()
  def keeping_up?(%__MODULE__{by_ref: by_ref}, stream),
    do:
      not Enum.any?(by_ref, fn {_, reader} ->
        reader.name == stream.name and reader_lags?(reader, stream)
      end)

  defp reader_lags?(%{queue: nil, live: true} = reader, stream),
    do:
      exceeds_limits?(OutgoingStream.last_visible(stream) - reader.last, reader.weight) and
        within_patience?(reader, stream.direct)

  defp reader_lags?(_reader, _out), do: false

  defp exceeds_limits?(count, weight), do: count >= @max_messages or count * weight >= @max_bytes
  defp within_patience?(reader, true), do: monotonic_ms() - reader.asked_ms < @direct_patience_ms
  defp within_patience?(reader, false), do: monotonic_ms() - reader.asked_ms < @patience_ms
  defp monotonic_ms, do: System.monotonic_time(:millisecond)

  @doc "Offers new messages of a direct stream to the readers that may lose them."
  @spec offer_batch(t(), OutgoingStream.t(), MessageBatch.t()) :: t()
  def offer_batch(%__MODULE__{by_ref: by_ref} = readers, stream, batch) do
    by_ref =
      Map.new(by_ref, fn {ref, reader} ->
        queued? = reader.name == stream.name and reader.queue != nil
        {ref, if(queued?, do: offer_to_reader(reader, batch), else: reader)}
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
  def add_demand(%__MODULE__{by_ref: by_ref} = readers, ref, count) do
    case by_ref do
      %{^ref => reader} ->
        reader = %{reader | demand: reader.demand + count, asked_ms: monotonic_ms()}
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
  def serve_stream(%__MODULE__{by_ref: by_ref} = readers, stream, log) do
    by_ref =
      for {ref, reader} <- by_ref,
          reader =
            if(reader.name == stream.name, do: serve_reader(reader, stream, log), else: reader),
          reader != nil,
          into: %{},
          do: {ref, reader}

    %{readers | by_ref: by_ref}
  end

  defp serve_reader(%{queue: %Queue{size: count}, demand: demand} = reader, stream, log)
       when count > 0 and demand > 0 do
    {messages, _took, queue} = Queue.take(reader.queue, demand)
    %{reader | queue: queue} |> send_messages(messages) |> serve_reader(stream, log)
  end

  defp serve_reader(%{queue: %Queue{size: count}} = reader, _out, _log) when count > 0, do: reader

  defp serve_reader(%{queue: %Queue{}} = reader, %{stored_mark: %{closing: nil}}, _log),
    do: reader

  defp serve_reader(
         %{queue: queue, last: last} = reader,
         %{stored_mark: %{last: end_id, closing: time}},
         _log
       )
       when time != nil and (queue != nil or last == end_id) do
    Process.demonitor(reader.monitor, [:flush])

    send(
      reader.pid,
      {:"$gen_consumer", {self(), reader.ref}, {:cancel, {:shutdown, {:closed, time}}}}
    )

    nil
  end

  defp serve_reader(%{demand: demand} = reader, _out, _log) when demand <= 0, do: reader

  defp serve_reader(%{fetched: []} = reader, stream, log) do
    if reader.last >= OutgoingStream.last_visible(stream) do
      reader
    else
      case OutgoingStream.fetch_batch(stream, reader.last + 1) do
        {:ok, batch} ->
          %{reader | live: true} |> send_batch(batch) |> serve_reader(stream, log)

        :gone when stream.direct ->
          reader
          |> skip_missed(OutgoingStream.last_id_at(stream, nil))
          |> serve_reader(stream, log)

        :gone ->
          %{reader | live: false} |> fetch_entry(stream, log) |> serve_fetched(stream, log)
      end
    end
  end

  defp serve_reader(reader, stream, log) do
    {sendable, rest} = Enum.split(reader.fetched, reader.demand)
    %{reader | fetched: rest} |> send_messages(sendable) |> serve_reader(stream, log)
  end

  defp skip_missed(reader, last),
    do: %{reader | last: last, dropped: reader.dropped + last - reader.last}

  defp serve_fetched(%{fetched: []} = reader, _out, _log), do: reader
  defp serve_fetched(reader, stream, log), do: serve_reader(reader, stream, log)

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

  defp send_to_reader(reader, %{last: last} = batch, payload) do
    send(reader.pid, {:"$gen_consumer", {self(), reader.ref}, payload})
    count = if is_list(payload), do: length(payload), else: last - batch.first + 1
    reader = if is_list(payload), do: reader, else: put_weight(reader, batch)
    %{reader | demand: reader.demand - count, last: last}
  end

  # Reads the next entry with messages that the reader lacks. After an error of the log, the next request tries again.
  defp fetch_entry(%{next_seq: nil} = reader, stream, log) do
    case Log.find_position(
           log,
           stream.subject,
           &(Entry.head_integer(&1, "Last", 0) > reader.last)
         ) do
      {:ok, seq} when is_integer(seq) -> fetch_entry(%{reader | next_seq: seq}, stream, log)
      _ -> reader
    end
  end

  defp fetch_entry(reader, stream, log) do
    with {:ok, [entry]} <- Log.read(log, stream.subject, reader.next_seq, 1),
         {:ok, messages} <- StreamEntry.decode_messages(entry) do
      reader = %{reader | next_seq: entry.seq + 1}

      case Enum.drop_while(messages, &(&1.sequence_id <= reader.last)) do
        [] when entry.seq < stream.seq -> fetch_entry(reader, stream, log)
        messages -> %{reader | fetched: messages}
      end
    else
      {:error, error} -> log_refusal(%{reader | next_seq: nil}, error)
      _ -> %{reader | next_seq: nil}
    end
  end

  # The reader gets no messages from a refused entry and tries again, since the log may be repaired.
  defp log_refusal(reader, error) do
    if SignedEntry.refusal?(error) and not reader.refusal_logged?,
      do: Logger.error("#{reader.part} waits for #{reader.name}: #{Exception.message(error)}")

    %{reader | refusal_logged?: reader.refusal_logged? or SignedEntry.refusal?(error)}
  end
end

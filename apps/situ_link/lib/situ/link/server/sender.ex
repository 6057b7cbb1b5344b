defmodule Situ.Link.Server.Sender do
  @moduledoc false
  # Sends the messages of a session, one frame of the scheduled channel at a time, so that a more important channel
  # never waits for more than one frame. Operates on the state of the session.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Delivery
  alias Situ.Link.Wire.{Frame, Quota, Schedule, Socket}
  alias Situ.Link.Server.{Channel, DatagramSender, RecordingReader}

  # The maximum work before the session checks its mailbox again.
  @turn_bytes 4 * 1024 * 1024
  @turn_reads 64
  # Longer batches are sent in parts.
  @max_part 4 * 1024 * 1024

  @type state :: map()

  @doc "Opens the stream of a new channel, if a stream of that name exists."
  @spec open_channel(state(), Frame.channel()) :: state()
  def open_channel(state, id) do
    channel = state.channels[id]

    case RecordingReader.open_cursor(state.reader, channel.name, channel.from) do
      {:ok, cursor, start} ->
        {channel, reply} = start_datagrams(channel, state.socket)
        _ = send_frame(state, {:subscribed, id, Map.put(reply, "after", start)})
        put_channel(state, %{channel | cursor: cursor, state: :open})

      :unknown ->
        state
    end
  end

  # Uses datagrams if the client asked for them and the connection is over a network.
  defp start_datagrams(%{udp: {key, size}} = channel, socket) do
    with ip when ip != nil <- Socket.local_address(socket),
         {:ok, pid, port} <- DatagramSender.start_sender(ip, channel.id, key, size) do
      {%{channel | datagrams: pid}, %{"udp" => port}}
    else
      _ -> {channel, %{}}
    end
  end

  defp start_datagrams(channel, _socket), do: {channel, %{}}

  @doc "Opens the channels whose streams did not exist before."
  @spec open_waiting(state()) :: state()
  def open_waiting(state) do
    for({id, %{state: :waiting}} <- state.channels, do: id)
    |> Enum.reduce(state, &open_channel(&2, &1))
  end

  @doc "Stores a changed channel, and schedules it if it can send."
  @spec put_channel(state(), Channel.t()) :: state()
  def put_channel(state, channel) do
    state = %{state | channels: Map.put(state.channels, channel.id, channel)}

    if Channel.can_send?(channel),
      do: %{state | schedule: Schedule.put(state.schedule, channel.id, channel.priority)},
      else: state
  end

  @doc "Schedules all channels that can send, since every stream may have new messages."
  @spec schedule_all(state()) :: state()
  def schedule_all(state) do
    schedule =
      for {id, channel} <- state.channels, Channel.can_send?(channel), reduce: state.schedule do
        schedule -> Schedule.put(schedule, id, channel.priority)
      end

    %{state | schedule: schedule}
  end

  @doc "Returns whether all available data was sent."
  @spec drained?(state()) :: boolean()
  def drained?(state) do
    state.stage != :open or
      Enum.all?(state.channels, fn {_, channel} ->
        channel.state != :open or (channel.frames == [] and channel_idle?(state, channel))
      end)
  end

  # The channel has no unsent messages, and the client knows about the end of the stream.
  defp channel_idle?(state, channel),
    do: match?({:idle, _}, RecordingReader.read(state.reader, channel.cursor))

  @doc "Sends the queued replies, as far as the quota allows."
  @spec send_replies(state()) ::
          {:sent, state()} | {:wait, pos_integer(), state()} | {:error, term(), state()}
  def send_replies(state) do
    with {{:value, {id, part}}, rest} <- :queue.out(state.replies),
         size = IO.iodata_length(part),
         {:sending, :ok} <- {:sending, send_frame(state, {:reply, id, part})} do
      state = %{state | replies: rest, sent: state.sent + size}

      case Quota.charge_sent(state.config.quota, size, 0, System.monotonic_time(:nanosecond)) do
        0 -> send_replies(state)
        ns -> {:wait, ns, state}
      end
    else
      {:empty, _} -> {:sent, state}
      {:sending, {:error, reason}} -> {:error, reason, state}
    end
  end

  @doc """
  Sends messages for one time slice. Returns whether more is left to send, the quota requires a pause, or nothing is
  left for now. In the last case, the session receives a message when more data may be available.
  """
  @spec send_frames(state()) ::
          {:more, state()}
          | {:wait, pos_integer(), state()}
          | {:idle, state()}
          | {:error, term(), state()}
  def send_frames(state), do: send_scheduled(state, @turn_bytes, @turn_reads)

  defp send_scheduled(state, bytes, reads) when bytes <= 0 or reads <= 0, do: {:more, state}

  defp send_scheduled(state, bytes, reads) do
    case Schedule.take(state.schedule) do
      :empty ->
        {:idle, %{state | reader: RecordingReader.request_notice(state.reader)}}

      {id, schedule} ->
        serve_channel(%{state | schedule: schedule}, state.channels[id], bytes, reads)
    end
  end

  # The channel may be gone, or may have no credit left.
  defp serve_channel(state, nil, bytes, reads), do: send_scheduled(state, bytes, reads)

  defp serve_channel(state, channel, bytes, reads) do
    if Channel.can_send?(channel),
      do: state |> send_next(channel) |> continue_after(bytes, reads),
      else: send_scheduled(state, bytes, reads)
  end

  defp continue_after({:sent, 0, 0, state}, bytes, reads),
    do: send_scheduled(state, bytes, reads - 1)

  defp continue_after({:sent, size, messages, state}, bytes, reads) do
    state = %{state | sent: state.sent + size, messages: state.messages + messages}

    case Quota.charge_sent(state.config.quota, size, messages, System.monotonic_time(:nanosecond)) do
      0 -> send_scheduled(state, bytes - size, reads - 1)
      ns -> {:wait, ns, state}
    end
  end

  defp continue_after({:error, reason, state}, _bytes, _reads), do: {:error, reason, state}

  defp send_next(state, %{frames: [{frame, size, messages} | frames]} = channel) do
    case send_data(state, channel, frame, messages) do
      :ok ->
        sent = channel.sent + messages
        channel = %{channel | frames: frames, credit: channel.credit - size, sent: sent}
        {:sent, size, messages, put_channel(state, channel)}

      {:error, reason} ->
        {:error, reason, state}
    end
  end

  defp send_next(state, %{frames: []} = channel) do
    {state, channel} = skip_messages(state, channel)

    case RecordingReader.read(state.reader, channel.cursor) do
      {:parts, parts, cursor} ->
        max =
          if channel.datagrams,
            do: :any,
            else: Quota.segment_size(state.config.quota, @max_part)

        frames = Enum.flat_map(parts, &batch_to_frames(&1, channel.id, max))
        send_next(state, %{channel | frames: frames, cursor: cursor})

      {:idle, cursor} ->
        # The channel is not scheduled until new data arrives.
        channels = Map.put(state.channels, channel.id, %{channel | cursor: cursor})
        {:sent, 0, 0, %{state | channels: channels}}

      {:ended, time} ->
        _ = send_frame(state, {:closed, channel.id, time})
        {:sent, 0, 0, put_channel(state, %{channel | state: :ended})}
    end
  end

  defp send_data(state, %{datagrams: nil}, frame, _messages), do: Socket.send(state.socket, frame)

  defp send_data(_state, channel, frame, messages),
    do: DatagramSender.send_frame(channel.datagrams, frame, messages)

  # A lossy policy skips messages only when the stream is about to be sent, when the capacity of the link is known.
  defp skip_messages(state, %{policy: policy} = channel) do
    if Delivery.lossy?(policy) do
      {skipped, cursor} =
        RecordingReader.skip_messages(channel.cursor, policy, state.config.now.())

      state = report_lost(state, channel, skipped)
      {state, %{channel | cursor: cursor, dropped: channel.dropped + skipped}}
    else
      {state, channel}
    end
  end

  defp report_lost(state, _channel, 0), do: state

  defp report_lost(state, channel, n) do
    _ = send_frame(state, {:lost, channel.id, n})
    state
  end

  defp batch_to_frames({first, last, count, payload}, id, max) do
    frame = Frame.encode({:batch, id, first, last, count, payload})
    size = IO.iodata_length(frame)

    if size <= max,
      do: [{frame, size, count}],
      else: split_frame(IO.iodata_to_binary(frame), id, count, max)
  end

  defp split_frame(bytes, id, count, max) when byte_size(bytes) <= max,
    do: [{Frame.encode({:part, id, true, bytes}), byte_size(bytes), count}]

  defp split_frame(bytes, id, count, max) do
    <<part::binary-pinned_size(max), rest::binary>> = bytes
    [{Frame.encode({:part, id, false, part}), max, 0} | split_frame(rest, id, count, max)]
  end

  defp send_frame(state, frame), do: Socket.send(state.socket, Frame.encode(frame))
end

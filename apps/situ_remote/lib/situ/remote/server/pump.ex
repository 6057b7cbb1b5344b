defmodule Situ.Remote.Server.Pump do
  @moduledoc false
  # Sends the messages of a session, one frame of the scheduled channel at a time, so that a more important channel
  # never waits for more than one frame. Operates on the state of the session.
  import Situ.Bits, only: [known: 1]
  alias Situ.Delivery
  alias Situ.Remote.Link.{Frame, Quota, Schedule, Socket}
  alias Situ.Remote.Server.{Channel, Datagrams}

  # The maximum work before the session checks its mailbox again.
  @turn_bytes 4 * 1024 * 1024
  @turn_reads 64
  # Longer batches are sent in parts.
  @most_piece 4 * 1024 * 1024

  @type state :: map()

  @doc "Opens the stream of a new channel, if a stream of that name exists."
  @spec open(state(), Frame.channel()) :: state()
  def open(state, id) do
    channel = state.channels[id]

    case state.module.cursor(state.origin, channel.name, channel.from) do
      {:ok, cursor, before} ->
        {channel, told} = aside(channel, state.socket)
        _ = send_frame(state, {:subscribed, id, Map.put(told, "after", before)})
        put(state, %{channel | cursor: cursor, state: :open})

      :unknown ->
        state
    end
  end

  # Uses datagrams if the client asked for them and the connection is over a network.
  defp aside(%{udp: {key, size}} = channel, socket) do
    with ip when ip != nil <- Socket.local(socket),
         {:ok, pid, port} <- Datagrams.start(ip, channel.id, key, size) do
      {%{channel | datagrams: pid}, %{"udp" => port}}
    else
      _ -> {channel, %{}}
    end
  end

  defp aside(channel, _socket), do: {channel, %{}}

  @doc "Opens the channels whose streams did not exist before."
  @spec open_waiting(state()) :: state()
  def open_waiting(state) do
    for({id, %{state: :waiting}} <- state.channels, do: id) |> Enum.reduce(state, &open(&2, &1))
  end

  @doc "Stores a changed channel, and schedules it if it can send."
  @spec put(state(), Channel.t()) :: state()
  def put(state, channel) do
    state = %{state | channels: Map.put(state.channels, channel.id, channel)}

    if Channel.ready?(channel),
      do: %{state | schedule: Schedule.put(state.schedule, channel.id, channel.priority)},
      else: state
  end

  @doc "Schedules all channels that can send, since every stream may have new messages."
  @spec wake(state()) :: state()
  def wake(state) do
    schedule =
      for {id, channel} <- state.channels, Channel.ready?(channel), reduce: state.schedule do
        schedule -> Schedule.put(schedule, id, channel.priority)
      end

    %{state | schedule: schedule}
  end

  @doc "Returns whether all available data was sent."
  @spec drained?(state()) :: boolean()
  def drained?(state) do
    state.stage != :open or
      Enum.all?(state.channels, fn {_, channel} ->
        channel.state != :open or (channel.out == [] and idle?(state, channel))
      end)
  end

  # The channel has no unsent messages, and the client knows about the end of the stream.
  defp idle?(state, channel),
    do: match?({:idle, _}, state.module.read(state.origin, channel.cursor))

  @doc "Sends the queued replies, as far as the quota allows."
  @spec replies(state()) ::
          {:sent, state()} | {:wait, pos_integer(), state()} | {:error, term(), state()}
  def replies(state) do
    with {{:value, {id, piece}}, rest} <- :queue.out(state.replies),
         size = IO.iodata_length(piece),
         {:sending, :ok} <- {:sending, send_frame(state, {:reply, id, piece})} do
      state = %{state | replies: rest, sent: state.sent + size}

      case Quota.take(state.config.quota, size, 0, System.monotonic_time(:nanosecond)) do
        0 -> replies(state)
        ns -> {:wait, ns, state}
      end
    else
      {:empty, _} -> {:sent, state}
      {:sending, {:error, reason}} -> {:error, reason, state}
    end
  end

  @doc """
  Sends messages for one time slice. Returns whether more is left to send, the quota requires a pause, or nothing is
  left for now.
  """
  @spec run(state()) ::
          {:more, state()}
          | {:wait, pos_integer(), state()}
          | {:idle, state()}
          | {:error, term(), state()}
  def run(state), do: run(state, @turn_bytes, @turn_reads)

  defp run(state, bytes, reads) when bytes <= 0 or reads <= 0, do: {:more, state}

  defp run(state, bytes, reads) do
    case Schedule.take(state.schedule) do
      :empty ->
        {:idle, state}

      {id, schedule} ->
        turn(%{state | schedule: schedule}, state.channels[id], bytes, reads)
    end
  end

  # The channel may be gone, or may have no credit left.
  defp turn(state, nil, bytes, reads), do: run(state, bytes, reads)

  defp turn(state, channel, bytes, reads) do
    if Channel.ready?(channel),
      do: state |> step(channel) |> stepped(bytes, reads),
      else: run(state, bytes, reads)
  end

  defp stepped({:sent, 0, 0, state}, bytes, reads), do: run(state, bytes, reads - 1)

  defp stepped({:sent, size, messages, state}, bytes, reads) do
    state = %{state | sent: state.sent + size, messages: state.messages + messages}

    case Quota.take(state.config.quota, size, messages, System.monotonic_time(:nanosecond)) do
      0 -> run(state, bytes - size, reads - 1)
      ns -> {:wait, ns, state}
    end
  end

  defp stepped({:error, reason, state}, _bytes, _reads), do: {:error, reason, state}

  defp step(state, %{out: [{frame, size, messages} | out]} = channel) do
    case transmit(state, channel, frame, messages) do
      :ok ->
        sent = channel.sent + messages
        channel = %{channel | out: out, credit: channel.credit - size, sent: sent}
        {:sent, size, messages, put(state, channel)}

      {:error, reason} ->
        {:error, reason, state}
    end
  end

  defp step(state, %{out: []} = channel) do
    {state, channel} = lighten(state, channel)

    case state.module.read(state.origin, channel.cursor) do
      {:parts, parts, lost, cursor} ->
        most = if channel.datagrams, do: :any, else: Quota.piece(state.config.quota, @most_piece)
        out = Enum.flat_map(parts, &frames(&1, channel.id, most))
        state = told_lost(state, channel, lost)
        step(state, %{channel | out: out, cursor: cursor, dropped: channel.dropped + lost})

      {:idle, cursor} ->
        # The channel is not scheduled until new data arrives.
        channels = Map.put(state.channels, channel.id, %{channel | cursor: cursor})
        {:sent, 0, 0, %{state | channels: channels}}

      {:ended, time} ->
        _ = send_frame(state, {:closed, channel.id, time})
        {:sent, 0, 0, put(state, %{channel | state: :ended})}
    end
  end

  defp transmit(state, %{datagrams: nil}, frame, _messages), do: Socket.send(state.socket, frame)

  defp transmit(_state, channel, frame, messages),
    do: Datagrams.send_frame(channel.datagrams, frame, messages)

  # A lossy policy skips messages only when the stream is about to be sent, when the capacity of the link is known.
  defp lighten(state, %{policy: policy} = channel) do
    if Delivery.lossy?(policy) do
      {skipped, cursor} =
        state.module.skip(state.origin, channel.cursor, policy, state.config.now.())

      state = told_lost(state, channel, skipped)
      {state, %{channel | cursor: cursor, dropped: channel.dropped + skipped}}
    else
      {state, channel}
    end
  end

  defp told_lost(state, _channel, 0), do: state

  defp told_lost(state, channel, n) do
    _ = send_frame(state, {:lost, channel.id, n})
    state
  end

  defp frames({first, last, count, payload}, id, most) do
    frame = Frame.encode({:batch, id, first, last, count, payload})
    size = IO.iodata_length(frame)

    if size <= most,
      do: [{frame, size, count}],
      else: pieces(IO.iodata_to_binary(frame), id, count, most)
  end

  defp pieces(bytes, id, count, most) when byte_size(bytes) <= most,
    do: [{Frame.encode({:part, id, true, bytes}), byte_size(bytes), count}]

  defp pieces(bytes, id, count, most) do
    <<piece::binary-known(most), rest::binary>> = bytes
    [{Frame.encode({:part, id, false, piece}), most, 0} | pieces(rest, id, count, most)]
  end

  defp send_frame(state, frame), do: Socket.send(state.socket, Frame.encode(frame))
end

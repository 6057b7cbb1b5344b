defmodule Situ.Link.Connection.FrameHandler do
  @moduledoc false
  # Handles the frames that a server sends: delivers messages and events to the components of the streams, and returns
  # credit to the server. All functions take and return the state of the connection.
  alias Situ.Link.Connection.{Catalogue, Channel, DatagramReceiver}
  alias Situ.Link.Wire.{ClockEstimate, Frame, Handshake, Socket}

  @doc "Handles a frame of `size` bytes. Returns `{:error, reason}` if the link must be closed."
  @spec handle_frame(tuple(), non_neg_integer(), map()) :: {:ok, map()} | {:error, String.t()}
  def handle_frame({:batch, id, _first, last, count, payload}, size, state),
    do: deliver_batch(state, id, size, last, count, payload)

  def handle_frame({:part, id, last?, bytes}, _size, state) do
    case state.channels do
      %{^id => channel} ->
        case Channel.add_part(channel, last?, bytes) do
          {:more, channel} ->
            {:ok, send_credit(state, channel)}

          {:complete, body, channel} ->
            handle_joined_batch(Frame.decode(body), byte_size(bytes), put_channel(state, channel))

          {:error, why} ->
            {:error, why}
        end

      _ ->
        {:ok, state}
    end
  end

  def handle_frame({:streams, %{"streams" => streams}}, _size, state) when is_list(streams),
    do: {:ok, %{state | catalogue: Catalogue.merge_streams(state.catalogue, streams)}}

  def handle_frame({:subscribed, id, %{"after" => time} = map}, _size, state)
      when is_integer(time) do
    case state.channels do
      %{^id => channel} ->
        DatagramReceiver.handle_subscribed(channel, map, state.socket)
        {:ok, put_channel(state, Channel.mark_subscribed(channel, time))}

      _ ->
        {:ok, state}
    end
  end

  def handle_frame({:closed, id, time}, _size, state),
    do: {:ok, deliver_event(state, id, {:closed, time})}

  def handle_frame({:lost, id, n}, _size, state), do: {:ok, deliver_event(state, id, {:lost, n})}

  def handle_frame({:pong, t0, t1, t2}, _size, state) do
    {:ok,
     %{state | clock: ClockEstimate.add_round_trip(state.clock, {t0, t1, t2, state.opts.now.()})}}
  end

  def handle_frame({:refused, map}, _size, _state),
    do: {:error, map |> Handshake.error_from_map() |> Exception.message()}

  def handle_frame(frame, _size, _state), do: {:error, "unexpected frame: #{elem(frame, 0)}"}

  defp handle_joined_batch({:ok, {:batch, _, _, _, _, _} = batch}, size, state),
    do: handle_frame(batch, size, state)

  defp handle_joined_batch(_other, _size, _state),
    do: {:error, "the joined parts are not a batch"}

  defp deliver_batch(state, id, size, last, count, payload) do
    case state.channels do
      %{^id => channel} ->
        case Channel.accept_batch(channel, size, last, count) do
          {:ok, channel} ->
            send(
              channel.pid,
              {:situ_link, id, {:batch, size, payload, channel_clock(state, channel)}}
            )

            {:ok, put_channel(state, channel)}

          {:duplicate, channel} ->
            {:ok, send_credit(state, channel)}

          {:error, why} ->
            {:error, why}
        end

      _ ->
        {:ok, state}
    end
  end

  defp channel_clock(_state, %{times: :sender}), do: nil
  defp channel_clock(state, _channel), do: state.clock

  @doc "Sends an event of a stream to the stream's subscriber."
  @spec deliver_event(map(), Frame.channel(), {:closed, Situ.Time.t()} | {:lost, pos_integer()}) ::
          map()
  def deliver_event(state, id, event) do
    case state.channels do
      %{^id => channel} ->
        send(
          channel.pid,
          {:situ_link, id, convert_event_time(event, channel_clock(state, channel))}
        )

        put_channel(state, Channel.apply_event(channel, event))

      _ ->
        state
    end
  end

  defp convert_event_time({:closed, time}, clock) when clock != nil,
    do: {:closed, ClockEstimate.to_local_time(clock, time)}

  defp convert_event_time(event, _clock), do: event

  @doc "Sends the server the credit for the messages that the subscriber has consumed, unless it is still small."
  @spec send_credit(map(), Channel.t()) :: map()
  def send_credit(state, channel) do
    case Channel.take_credit(channel) do
      {0, channel} ->
        put_channel(state, channel)

      {bytes, channel} ->
        state |> put_channel(channel) |> send_frame({:credit, channel.id, bytes})
    end
  end

  @doc "Sends a frame to the server, if there is a connection."
  @spec send_frame(map(), tuple()) :: map()
  def send_frame(%{socket: nil} = state, _frame), do: state

  def send_frame(state, frame) do
    # An error is ignored here, because the socket then also reports that it was closed.
    _ = Socket.send(state.socket, Frame.encode(frame))
    state
  end

  @doc "Stores the state of a stream."
  @spec put_channel(map(), Channel.t()) :: map()
  def put_channel(state, channel),
    do: %{state | channels: Map.put(state.channels, channel.id, channel)}
end

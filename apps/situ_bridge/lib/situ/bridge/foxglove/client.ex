defmodule Situ.Bridge.Foxglove.Client do
  @moduledoc false
  # One connection: the WebSocket around a session. A client that does not read blocks only this process, which closes
  # the connection after 30 s. The process also closes it when a client does not finish a message in that time.
  use GenServer, restart: :temporary
  alias Situ.Bridge.Foxglove.{Session, StoreChannels}
  alias Situ.Bridge.Net.SendQueue
  alias Situ.Bridge.WebSocket.{Frames, Handshake}

  @tick_ms 20
  @admission_ms 5_000
  @max_message 1_000_000
  @message_ms 30_000

  def start_link(args), do: GenServer.start_link(__MODULE__, args)

  @impl true
  def init(args) do
    Process.send_after(self(), :too_slow, @admission_ms)

    state = %{
      tcp: nil,
      received_bytes: "",
      partial_message: nil,
      session: nil,
      deadline: nil,
      message_ms: @message_ms
    }

    {:ok, Map.merge(state, args)}
  end

  @impl true
  def handle_info({:adopt, tcp}, state) do
    :inet.setopts(tcp, [active: :once] ++ SendQueue.socket_options())
    {:noreply, %{state | tcp: tcp}}
  end

  def handle_info({:tcp, _, bytes}, %{session: nil} = state) do
    received_bytes = state.received_bytes <> bytes

    case Handshake.admit_client(received_bytes,
           origins: state.origins,
           protocols: Session.supported_protocols()
         ) do
      {:ok, response, protocol, _path, rest} ->
        open_session(response, protocol, %{state | received_bytes: rest})

      :more ->
        resume_reading(%{state | received_bytes: received_bytes})

      {:refuse, response} ->
        send_bytes(response, state, fn state -> {:stop, {:shutdown, :refused}, state} end)
    end
  end

  def handle_info({:tcp, _, bytes}, state) do
    case Frames.split_messages(
           state.received_bytes <> bytes,
           state.partial_message,
           true,
           @max_message
         ) do
      {:ok, events, rest, partial_message} ->
        handle_events(
          events,
          limit_message(%{state | received_bytes: rest, partial_message: partial_message}, events)
        )

      {:error, why} ->
        {:stop, {:shutdown, why}, state}
    end
  end

  def handle_info({:tcp_closed, _}, state), do: {:stop, {:shutdown, :closed}, state}
  def handle_info({:tcp_error, _, reason}, state), do: {:stop, {:shutdown, reason}, state}
  def handle_info(:too_slow, %{session: nil} = state), do: {:stop, {:shutdown, :too_slow}, state}
  def handle_info(:too_slow, state), do: {:noreply, state}

  def handle_info({:timeout, deadline, :message}, %{deadline: deadline} = state),
    do: {:stop, {:shutdown, :too_slow}, state}

  def handle_info({:timeout, _, :message}, state), do: {:noreply, state}

  def handle_info(:tick, state) do
    {frames, session} = Session.tick(state.session, System.monotonic_time(:nanosecond))

    send_bytes(encode_frames(frames), %{state | session: session}, fn state ->
      Process.send_after(self(), :tick, @tick_ms)
      {:noreply, state}
    end)
  end

  # The time limit for a message starts at its first byte.
  defp limit_message(%{received_bytes: "", partial_message: nil} = state, _events),
    do: %{state | deadline: nil}

  defp limit_message(%{deadline: deadline} = state, []) when deadline != nil, do: state

  defp limit_message(state, _events),
    do: %{state | deadline: :erlang.start_timer(state.message_ms, self(), :message)}

  defp open_session(response, protocol, state) do
    {frames, session} = Session.open(StoreChannels.new(state.store), state.name, protocol)
    send(self(), :tick)
    send_bytes([response | encode_frames(frames)], %{state | session: session}, &resume_reading/1)
  end

  defp handle_events(events, state) do
    now = System.monotonic_time(:nanosecond)

    Enum.reduce_while(events, {[], state}, fn
      {kind, _} = frame, {output, state} when kind in [:text, :binary] ->
        {frames, session} = Session.handle_frame(state.session, frame, now)
        {:cont, {[output | encode_frames(frames)], %{state | session: session}}}

      {:ping, data}, {output, state} ->
        {:cont, {[output, Frames.encode_frame(:pong, data)], state}}

      {:pong, _}, acc ->
        {:cont, acc}

      {:close, code}, {output, state} ->
        {:halt,
         {:close,
          [output, Frames.encode_frame(:close, binary_part(code, 0, min(byte_size(code), 2)))],
          state}}
    end)
    |> case do
      {:close, output, state} ->
        send_bytes(output, state, fn state -> {:stop, {:shutdown, :closed}, state} end)

      {output, state} ->
        send_bytes(output, state, &resume_reading/1)
    end
  end

  defp encode_frames(frames),
    do: for({kind, payload} <- frames, do: Frames.encode_frame(kind, payload))

  defp send_bytes(bytes, state, next) do
    case bytes == [] || :gen_tcp.send(state.tcp, bytes) do
      {:error, reason} -> {:stop, {:shutdown, reason}, state}
      _ -> next.(state)
    end
  end

  defp resume_reading(state) do
    :inet.setopts(state.tcp, active: :once)
    {:noreply, state}
  end
end

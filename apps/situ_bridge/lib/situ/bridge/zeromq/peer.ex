defmodule Situ.Bridge.ZeroMQ.Peer do
  @moduledoc false
  # One connection of a ZeroMQ socket: performs the handshake, sends messages for the socket, and receives messages.
  use GenServer, restart: :temporary
  alias Situ.Bridge.Net.{SendQueue, ReceiveBuffer}
  alias Situ.Bridge.ZeroMQ.Wire

  # The time limit of the handshake, ms.
  @handshake_ms 5_000

  def start_link(opts), do: GenServer.start_link(__MODULE__, opts)

  @impl true
  def init(opts) do
    initial = %{
      tcp: nil,
      phase: :greeting,
      buffer: "",
      receive_buffer: %ReceiveBuffer{},
      parts: [],
      waiting: 0
    }

    state = Map.merge(initial, Map.new(opts))

    if state.address, do: send(self(), :connect)
    Process.send_after(self(), :too_slow, @handshake_ms)
    {:ok, state}
  end

  @impl true
  def handle_info(:connect, %{address: {host, port}} = state) do
    case :gen_tcp.connect(host, port, tcp_options(), @handshake_ms) do
      {:ok, tcp} -> begin_handshake(tcp, state)
      {:error, reason} -> {:stop, {:shutdown, {:unreachable, reason}}, state}
    end
  end

  def handle_info({:adopt, tcp}, state) do
    :inet.setopts(tcp, tcp_options())
    begin_handshake(tcp, state)
  end

  def handle_info({:tcp, tcp, bytes}, %{tcp: tcp} = state) do
    missing = if state.phase == :open, do: Wire.missing_bytes(state.buffer), else: 1

    with {:ok, bytes, receive_buffer} <-
           ReceiveBuffer.add_bytes(state.receive_buffer, bytes, missing),
         state = %{state | buffer: state.buffer <> bytes, receive_buffer: receive_buffer},
         {:ok, state} <- handle_buffer(state) do
      {:noreply, arm_socket(state)}
    else
      {:more, receive_buffer} -> {:noreply, arm_socket(%{state | receive_buffer: receive_buffer})}
      {:error, why} -> {:stop, {:shutdown, {:refused, why}}, state}
    end
  end

  def handle_info({:tcp_closed, _}, state), do: {:stop, {:shutdown, :closed}, state}
  def handle_info({:tcp_error, _, reason}, state), do: {:stop, {:shutdown, reason}, state}
  def handle_info(:arm, state), do: {:noreply, arm_socket(state)}
  def handle_info(:too_slow, %{phase: :open} = state), do: {:noreply, state}

  def handle_info(:too_slow, state),
    do: {:stop, {:shutdown, {:refused, "the handshake timed out"}}, state}

  def handle_info({:send, bytes}, state) do
    case SendQueue.flush(state.send_queue, state.tcp, bytes) do
      :ok -> {:noreply, state}
      {:error, reason} -> {:stop, {:shutdown, reason}, state}
    end
  end

  defp tcp_options,
    do:
      [mode: :binary, active: false, buffer: ReceiveBuffer.buffer_size()] ++
        SendQueue.socket_options()

  defp begin_handshake(tcp, state) do
    case :gen_tcp.send(tcp, Wire.greeting()) do
      :ok -> {:noreply, arm_socket(%{state | tcp: tcp})}
      {:error, reason} -> {:stop, {:shutdown, reason}, state}
    end
  end

  # While the component has too many unprocessed messages, nothing more is read, so the other side queues or drops them.
  defp arm_socket(%{tcp: nil} = state), do: state

  defp arm_socket(state) do
    if :atomics.get(state.unread_counter, 1) < state.high_water_mark,
      do: :inet.setopts(state.tcp, active: :once),
      else: Process.send_after(self(), :arm, 5)

    state
  end

  defp handle_buffer(%{phase: :greeting} = state) do
    case Wire.parse_greeting(state.buffer) do
      {:ok, rest} ->
        :ok = ignore_result(:gen_tcp.send(state.tcp, Wire.encode_ready(state.type)))
        handle_buffer(%{state | phase: :ready, buffer: rest})

      :more ->
        {:ok, state}

      error ->
        error
    end
  end

  defp handle_buffer(%{phase: :ready} = state) do
    case Wire.parse_ready(state.buffer, state.type, 65_536) do
      {:ok, rest} ->
        for prefix <- state.subscriptions,
            do:
              ignore_result(
                :gen_tcp.send(state.tcp, Wire.encode_subscription(:subscribe, prefix))
              )

        send(state.socket, {:peer, self(), :open})
        handle_buffer(%{state | phase: :open, buffer: rest})

      :more ->
        {:ok, state}

      error ->
        error
    end
  end

  defp handle_buffer(%{phase: :open} = state) do
    with {:ok, events, parts, rest} <-
           Wire.parse_events(state.buffer, state.parts, state.type, state.max_bytes) do
      messages = for {:message, frames} <- events, do: frames

      for {kind, prefix} when kind != :message <- events,
          do: send(state.socket, {:peer, self(), {kind, prefix}})

      if messages != [] do
        :atomics.add(state.unread_counter, 1, length(messages))
        send(state.owner, {:zeromq, messages})
      end

      {:ok, %{state | buffer: rest, parts: parts}}
    end
  end

  # A broken connection is reported when it closes.
  defp ignore_result(_result), do: :ok
end

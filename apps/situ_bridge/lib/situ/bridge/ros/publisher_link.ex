defmodule Situ.Bridge.Ros.PublisherLink do
  @moduledoc false
  # Connects a subscriber to one publisher. The owner receives `{:ros, peer_fields, payloads}`, where `peer_fields`
  # contains the fields of the publisher's header. The link stops reading while too many messages wait for the owner.
  use GenServer, restart: :temporary
  alias Situ.Bridge.Net.ReceiveBuffer
  alias Situ.Bridge.Ros.{TcpRos, XmlRpc}

  @timeout_ms 5_000
  @silence_ms 1_000

  def start_link(args), do: GenServer.start_link(__MODULE__, args)

  @doc "Lets the link end as soon as it is silent, because its publisher has unregistered."
  @spec close_when_silent(pid()) :: :ok
  def close_when_silent(link), do: GenServer.cast(link, :leave)

  @impl true
  def init(args),
    do:
      {:ok,
       Map.merge(args, %{tcp: nil, wire: nil, receive_buffer: %ReceiveBuffer{}, packet_count: 0}),
       {:continue, :connect}}

  @impl true
  def handle_continue(:connect, state) do
    with {:ok, [1, _, ["TCPROS", host, port]]} when is_binary(host) and port in 1..65_535 <-
           XmlRpc.call(state.uri, "requestTopic", [state.caller, state.topic, [["TCPROS"]]]),
         {:ok, tcp} <-
           :gen_tcp.connect(
             String.to_charlist(host),
             port,
             [:binary, active: false, nodelay: true, buffer: ReceiveBuffer.buffer_size()] ++
               Situ.TcpKeepalive.options(),
             @timeout_ms
           ),
         {hello, wire} = TcpRos.hello(host, port, header_fields(state)),
         :ok <- :gen_tcp.send(tcp, hello) do
      {:noreply, arm_socket(%{state | tcp: tcp, wire: wire})}
    else
      {:error, %Situ.Error{} = error} -> {:stop, {:shutdown, Exception.message(error)}, state}
      {:error, reason} -> {:stop, {:shutdown, reason}, state}
      {:ok, answer} -> {:stop, {:shutdown, {:refused, answer}}, state}
    end
  end

  defp header_fields(state),
    do: %{
      "callerid" => state.caller,
      "topic" => state.topic,
      "type" => state.type,
      "md5sum" => state.md5sum,
      "tcp_nodelay" => "1"
    }

  @impl true
  def handle_info({:tcp, tcp, bytes}, %{tcp: tcp} = state) do
    state = %{state | packet_count: state.packet_count + 1}

    case ReceiveBuffer.add_bytes(state.receive_buffer, bytes, TcpRos.missing_bytes(state.wire)) do
      {:ok, bytes, receive_buffer} ->
        read_frames(bytes, %{state | receive_buffer: receive_buffer})

      {:more, receive_buffer} ->
        {:noreply, arm_socket(%{state | receive_buffer: receive_buffer})}
    end
  end

  def handle_info({:tcp_closed, _}, state), do: {:stop, {:shutdown, :closed}, state}
  def handle_info({:tcp_error, _, reason}, state), do: {:stop, {:shutdown, reason}, state}
  def handle_info(:arm, state), do: {:noreply, arm_socket(state)}

  def handle_info({:check, packet_count}, %{packet_count: packet_count} = state),
    do: {:stop, {:shutdown, :closed}, state}

  def handle_info({:check, _packet_count}, state), do: {:noreply, schedule_silence_check(state)}

  @impl true
  def handle_cast(:leave, state), do: {:noreply, schedule_silence_check(state)}

  # A publisher that leaves normally closes the connection. If it does not, the link ends when it is silent, unless this
  # side has stopped reading.
  defp schedule_silence_check(state) do
    paused? = :atomics.get(state.unread_counter, 1) >= state.high_water_mark
    packet_count = if paused?, do: :paused, else: state.packet_count
    Process.send_after(self(), {:check, packet_count}, @silence_ms)
    state
  end

  defp read_frames(bytes, state) do
    case TcpRos.read(bytes, state.wire, state.most) do
      {:ok, payloads, _, wire} ->
        {:noreply, %{state | wire: wire} |> hand_over(payloads) |> arm_socket()}

      {:error, why} ->
        {:stop, {:shutdown, why}, state}
    end
  end

  defp hand_over(state, []), do: state

  defp hand_over(state, payloads) do
    :atomics.add(state.unread_counter, 1, length(payloads))
    send(state.owner, {:ros, state.wire.peer_fields, payloads})
    send(state.node, {:received, state.uri})
    state
  end

  defp arm_socket(state) do
    if :atomics.get(state.unread_counter, 1) < state.high_water_mark,
      do: :inet.setopts(state.tcp, active: :once),
      else: Process.send_after(self(), :arm, 5)

    state
  end
end

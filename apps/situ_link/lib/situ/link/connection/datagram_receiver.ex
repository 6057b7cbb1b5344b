defmodule Situ.Link.Connection.DatagramReceiver do
  @moduledoc false
  # Receives one stream of a link as datagrams, in a separate process with its own socket. It sends a hello to the
  # server once a second, because firewalls forget idle flows. It reassembles frames and sends them to the connection
  # as `{:situ_datagrams, id, lost, body}`.
  use GenServer
  alias Situ.Link.Connection.Channel
  alias Situ.Link.Wire.{DatagramCodec, Socket}

  @hello_ms 1_000
  @first_hello_ms 50
  @batch 100

  defstruct [:socket, :connection, :id, :key, :decoder, :server, seq: 0, session: 0]

  @spec start_link(non_neg_integer(), binary()) :: {:ok, pid()}
  def start_link(id, key), do: GenServer.start_link(__MODULE__, {self(), id, key})

  @doc "Adds the datagram options to a stream's request and starts its receiver, with a new key each time."
  @spec add_datagram_request({map(), Channel.t()}) :: {map(), Channel.t()}
  def add_datagram_request({map, %{datagram: nil} = channel}), do: {map, channel}

  def add_datagram_request({map, %{datagram: size} = channel}) do
    stop_receiver(channel)
    key = :crypto.strong_rand_bytes(16)
    {:ok, pid} = start_link(channel.id, key)
    udp = %{"key" => Base.encode16(key, case: :lower), "size" => size}
    {Map.put(map, "udp", udp), %{channel | receiver: pid}}
  end

  @doc "Stops the receiver process of a stream."
  @spec stop_receiver(Channel.t()) :: term()
  def stop_receiver(%{receiver: nil}), do: :ok
  def stop_receiver(%{receiver: pid}), do: Process.exit(pid, :shutdown)

  @doc "Handles the server's reply to a subscription. The reply may contain the UDP port of the server."
  @spec handle_subscribed(Channel.t(), map(), Socket.t()) :: term()
  def handle_subscribed(%{receiver: pid}, %{"udp" => port}, socket)
      when pid != nil and port in 1..65_535 do
    with {:ok, ip} when is_tuple(ip) <- Socket.peer_address(socket),
         do: start_receiving(pid, {ip, port})
  end

  def handle_subscribed(_channel, _map, _socket), do: :ok

  @doc "Starts receiving from the address `server`, which the other side has announced over the connection."
  @spec start_receiving(pid(), {:inet.ip_address(), :inet.port_number()}) :: :ok
  def start_receiving(pid, server), do: GenServer.cast(pid, {:begin, server})

  @impl true
  def init({connection, id, key}) do
    receiver = DatagramCodec.new_receiver(key)
    {:ok, %__MODULE__{connection: connection, id: id, key: key, decoder: receiver}}
  end

  @impl true
  def handle_cast({:begin, {ip, _} = server}, state) do
    family = if tuple_size(ip) == 8, do: :inet6, else: :inet
    options = [:binary, family, active: @batch, recbuf: 8 * 1024 * 1024]
    {:ok, socket} = :gen_udp.open(0, options)
    {:noreply, send_hello(%{state | socket: socket, server: server})}
  end

  @impl true
  def handle_info(:hello, state), do: {:noreply, send_hello(state)}

  def handle_info({:udp_passive, socket}, state) do
    _ = :inet.setopts(socket, active: @batch)
    {:noreply, state}
  end

  def handle_info({:udp, socket, ip, port, bytes}, %{socket: socket, server: {ip, port}} = state) do
    {frames, receiver} = DatagramCodec.receive_datagram(state.decoder, bytes)

    for {lost, body} <- frames,
        do: send(state.connection, {:situ_datagrams, state.id, lost, body})

    {:noreply, %{state | decoder: receiver}}
  end

  def handle_info(_other, state), do: {:noreply, state}

  # The first hellos are sent in quick succession, since any of them may be lost.
  defp send_hello(state) do
    {ip, port} = state.server
    _ = :gen_udp.send(state.socket, ip, port, DatagramCodec.encode_hello(state.key, state.seq))
    Process.send_after(self(), :hello, if(state.seq < 10, do: @first_hello_ms, else: @hello_ms))
    %{state | seq: state.seq + 1}
  end
end

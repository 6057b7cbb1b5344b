defmodule Situ.Link.Server.DatagramSender do
  @moduledoc false
  # Sends one lossy stream to one client as datagrams, in a separate process with its own socket. It sends to the last
  # address that the client's hello came from, in bursts that a receiver can absorb, and notifies the session when a
  # frame was sent.
  #
  # A lost TCP segment delays everything after it, and an old image is worth less than the next
  # one. QUIC would need a large native library for one kind of stream. Only the messages of lossy
  # streams use datagrams; logins, catalogues, credits and the end of a stream stay on the
  # connection.
  use GenServer
  alias Situ.Link.Wire.DatagramCodec

  # Bytes per burst, followed by a pause: about 40 MB/s.
  @burst 40_000
  @pause_ms 1

  defstruct [:socket, :session, :id, :key, :sender, :client, queue: :queue.new(), paused?: false]

  @doc "Starts a sender that ends with the session. Returns `{:ok, pid, port}`."
  @spec start_sender(:inet.ip_address(), non_neg_integer(), binary(), pos_integer()) ::
          {:ok, pid(), :inet.port_number()} | {:error, term()}
  def start_sender(ip, id, key, size) do
    with {:ok, pid} <- GenServer.start_link(__MODULE__, {self(), id, key, size}),
         {:ok, port} <- GenServer.call(pid, {:open, ip}),
         do: {:ok, pid, port}
  end

  @doc "Sends a frame. The session then receives `{:situ_sent, id, bytes}`."
  @spec send_frame(pid(), iodata(), non_neg_integer()) :: :ok
  def send_frame(pid, frame, messages), do: GenServer.cast(pid, {:frame, frame, messages})

  @impl true
  def init({session, id, key, size}) do
    {:ok,
     %__MODULE__{session: session, id: id, key: key, sender: DatagramCodec.new_sender(key, size)}}
  end

  @impl true
  def handle_call({:open, ip}, _from, state) do
    family = if tuple_size(ip) == 8, do: :inet6, else: :inet

    with {:ok, socket} <-
           :gen_udp.open(0, [:binary, family, ip: ip, active: :once, sndbuf: 1024 * 1024]),
         {:ok, port} <- :inet.port(socket) do
      {:reply, {:ok, port}, %{state | socket: socket}}
    else
      error -> {:reply, error, state}
    end
  end

  @impl true
  def handle_cast({:frame, frame, messages}, state) do
    {datagrams, sender} = DatagramCodec.split_frame(state.sender, frame, messages)
    entries = Enum.map(datagrams, &{:datagram, &1}) ++ [{:done, IO.iodata_length(frame)}]
    queue = Enum.reduce(entries, state.queue, &:queue.in/2)
    {:noreply, send_queued(%{state | sender: sender, queue: queue}, @burst)}
  end

  @impl true
  def handle_info({:udp, socket, ip, port, bytes}, %{socket: socket} = state) do
    _ = :inet.setopts(socket, active: :once)
    hello? = DatagramCodec.hello?(state.key, bytes)
    {:noreply, if(hello?, do: send_queued(%{state | client: {ip, port}}, @burst), else: state)}
  end

  def handle_info(:resume, state), do: {:noreply, send_queued(%{state | paused?: false}, @burst)}
  def handle_info(_other, state), do: {:noreply, state}

  defp send_queued(%{client: nil} = state, _budget), do: state
  defp send_queued(%{paused?: true} = state, _budget), do: state

  defp send_queued(state, budget) when budget <= 0 do
    Process.send_after(self(), :resume, @pause_ms)
    %{state | paused?: true}
  end

  defp send_queued(state, budget) do
    case :queue.out(state.queue) do
      {{:value, {:datagram, bytes}}, queue} ->
        # A datagram that cannot be sent counts as lost in transit.
        _ = :gen_udp.send(state.socket, elem(state.client, 0), elem(state.client, 1), bytes)
        send_queued(%{state | queue: queue}, budget - byte_size(bytes))

      {{:value, {:done, size}}, queue} ->
        send(state.session, {:situ_sent, state.id, size})
        send_queued(%{state | queue: queue}, budget)

      {:empty, _} ->
        state
    end
  end
end

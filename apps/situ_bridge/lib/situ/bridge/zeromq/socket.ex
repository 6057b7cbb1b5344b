defmodule Situ.Bridge.ZeroMQ.Socket do
  @moduledoc false
  # A ZeroMQ socket: its peers with their subscriptions and send queues. The owner receives `{:zeromq, [[frame]]}`.
  use GenServer
  alias Situ.Bridge.Net.{Drain, Listener, SendQueue}
  alias Situ.Bridge.PeerSender
  alias Situ.Bridge.ZeroMQ.{Peer, Wire}
  alias Situ.Error
  @behaviour PeerSender
  require Logger

  @min_wait_ms 50
  @max_wait_ms 5_000

  defstruct [
    :type,
    :address,
    :bind?,
    :owner,
    :listener,
    :acceptor,
    :opts,
    :unread_counter,
    peers: %{},
    wait_ms: @min_wait_ms,
    dropped: 0,
    turn: 0,
    logged_error: nil
  ]

  @doc "Opens a socket that listens or connects. Errors: `:bad_address`, `:address_in_use`."
  @spec open(Wire.type(), String.t(), keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def open(type, address, opts) do
    with {:ok, endpoint} <- parse_address(address),
         {:ok, listener} <- open_listener(endpoint, opts[:bind]) do
      args = %{type: type, address: endpoint, listener: listener, owner: self(), opts: opts}
      {:ok, socket} = GenServer.start_link(__MODULE__, args)
      if listener, do: :ok = :gen_tcp.controlling_process(listener, socket)
      send(socket, :begin)
      {:ok, socket}
    end
  end

  @doc """
  Parses an address to a host and a port.

      iex> Situ.Bridge.ZeroMQ.Socket.parse_address("tcp://127.0.0.1:5555")
      {:ok, {'127.0.0.1', 5555}}
      iex> {:error, error} = Situ.Bridge.ZeroMQ.Socket.parse_address("ipc:///tmp/x")
      iex> error.code
      :bad_address
  """
  @spec parse_address(String.t()) ::
          {:ok, {charlist(), :inet.port_number()}} | {:error, Error.t()}
  def parse_address(address) do
    with [_, host, port] <-
           Regex.run(~r"\Atcp://([^:/]+|\[[0-9a-fA-F:]+\]):(\d{1,5})\z", address),
         port when port <= 65_535 <- String.to_integer(port) do
      {:ok,
       {host |> String.trim_leading("[") |> String.trim_trailing("]") |> String.to_charlist(),
        port}}
    else
      _ ->
        {:error,
         Error.new(:bad_address, "#{inspect(address)} is not a supported ZeroMQ address",
           fix: "write it like tcp://127.0.0.1:5555; tcp://*:5555 listens on all interfaces"
         )}
    end
  end

  @doc "Returns the port of a listening socket."
  def port(socket), do: GenServer.call(socket, :port)

  @doc "Sends frames to subscribers or to one peer; the first frame of a publisher is the topic."
  @impl PeerSender
  def put(socket, frames), do: GenServer.call(socket, {:put, frames}, :infinity)

  @doc "Returns the number of subscribers (of a publisher) or peers."
  @impl PeerSender
  def count_ready(socket), do: GenServer.call(socket, :ready)

  @impl PeerSender
  def count_dropped(socket), do: GenServer.call(socket, :dropped)

  @doc "Records that the owner has read `n` messages."
  def subtract_read(unread_counter, n), do: :atomics.sub(unread_counter, 1, n)

  @doc "Returns the counter of unread messages, which `subtract_read/2` decrements."
  def unread_counter(socket), do: GenServer.call(socket, :unread_counter)

  @doc "Waits until everything has been handed to the network, at most `timeout` ms, and closes."
  @impl PeerSender
  defdelegate close(socket, timeout), to: Drain

  defp open_listener(_parsed, false), do: {:ok, nil}
  defp open_listener({host, port}, true), do: Listener.listen(to_string(host), port)

  @impl true
  def init(args) do
    Process.flag(:trap_exit, true)
    bind? = args.listener != nil

    {:ok,
     struct!(__MODULE__, Map.merge(args, %{bind?: bind?, unread_counter: :atomics.new(1, [])}))}
  end

  @impl true
  def handle_call(:port, _from, state), do: {:reply, Listener.port(state.listener), state}

  def handle_call(:adopt, _from, state) do
    {pid, state} = start_peer(state, nil)
    {:reply, pid, state}
  end

  def handle_call(:unread_counter, _from, state), do: {:reply, state.unread_counter, state}
  def handle_call(:dropped, _from, state), do: {:reply, state.dropped, state}

  def handle_call(:ready, _from, %{type: :pub} = state),
    do:
      {:reply, Enum.count(state.peers, fn {_, peer} -> peer.open? and peer.prefixes != [] end),
       state}

  def handle_call(:ready, _from, state),
    do: {:reply, Enum.count(state.peers, fn {_, p} -> p.open? end), state}

  def handle_call({:put, [topic | _] = frames}, _from, %{type: :pub} = state) do
    bytes = Wire.encode_message(frames)

    subscribers =
      for {pid, peer} <- state.peers,
          peer.open?,
          Enum.any?(peer.prefixes, &String.starts_with?(topic, &1)),
          do: {pid, peer}

    dropped = Enum.count(subscribers, &(put_message(&1, bytes, state) == :full))
    {:reply, :ok, %{state | dropped: state.dropped + dropped}}
  end

  # Messages go to the peers in turn; peers without room are skipped.
  def handle_call({:put, frames}, _from, %{type: :push} = state) do
    open = Enum.filter(state.peers, fn {_, peer} -> peer.open? end)
    {skipped, from} = Enum.split(open, rem(state.turn, max(length(open), 1)))
    bytes = Wire.encode_message(frames)
    sent? = Enum.any?(from ++ skipped, &(put_message(&1, bytes, state) == :ok))
    {:reply, if(sent?, do: :ok, else: :full), %{state | turn: state.turn + 1}}
  end

  def handle_call({:drain, deadline}, from, state) do
    Drain.reply_when_drained(from, deadline, count_waiting(state), state.type == :pub)
    {:noreply, state}
  end

  defp count_waiting(state),
    do:
      state.peers
      |> Enum.map(fn {_, p} -> SendQueue.count_waiting(p.send_queue) end)
      |> Enum.sum()

  defp put_message({pid, peer}, bytes, state),
    do: SendQueue.put(peer.send_queue, pid, bytes, state.opts[:high_water_mark])

  @impl true
  def handle_info(:begin, %{bind?: true} = state),
    do: {:noreply, %{state | acceptor: Listener.start_acceptor(state.listener, self())}}

  def handle_info(:begin, state), do: {:noreply, connect_peer(state)}

  def handle_info({:drain, from, deadline}, state) do
    Drain.reply_when_drained(from, deadline, count_waiting(state), state.type == :pub)
    {:noreply, state}
  end

  def handle_info({:peer, pid, :open}, state),
    do:
      {:noreply,
       update_peer(
         %{state | wait_ms: @min_wait_ms, logged_error: nil},
         pid,
         &%{&1 | open?: true}
       )}

  def handle_info({:peer, pid, {:subscribe, prefix}}, state),
    do: {:noreply, update_peer(state, pid, &%{&1 | prefixes: [prefix | &1.prefixes]})}

  def handle_info({:peer, pid, {:unsubscribe, prefix}}, state),
    do: {:noreply, update_peer(state, pid, &%{&1 | prefixes: List.delete(&1.prefixes, prefix)})}

  def handle_info({:EXIT, pid, reason}, %{acceptor: pid} = state), do: {:stop, reason, state}

  def handle_info({:EXIT, pid, reason}, state) when is_map_key(state.peers, pid) do
    state = state |> Map.update!(:peers, &Map.delete(&1, pid)) |> report_failure(reason)
    unless state.bind?, do: Process.send_after(self(), :connect, state.wait_ms)
    {:noreply, %{state | wait_ms: min(state.wait_ms * 2, @max_wait_ms)}}
  end

  def handle_info({:EXIT, pid, reason}, %{owner: pid} = state), do: {:stop, reason, state}
  def handle_info({:EXIT, _pid, _reason}, state), do: {:noreply, state}
  def handle_info(:connect, state), do: {:noreply, connect_peer(state)}

  # A normal exit does not propagate through links, so the connections are stopped explicitly.
  @impl true
  def terminate(_reason, state) do
    for {pid, _} <- state.peers, do: Process.exit(pid, :shutdown)
    if state.listener, do: :gen_tcp.close(state.listener)
  end

  defp update_peer(state, pid, fun) do
    if is_map_key(state.peers, pid),
      do: %{state | peers: Map.update!(state.peers, pid, fun)},
      else: state
  end

  # A repeated error is logged once, not at every attempt.
  defp report_failure(state, {:shutdown, {kind, _} = reason})
       when kind in [:refused, :unreachable] do
    if state.logged_error != reason,
      do:
        Logger.warning(
          "ZeroMQ #{state.type} at #{elem(state.address, 0)}:#{elem(state.address, 1)}: #{inspect(reason)}"
        )

    %{state | logged_error: reason}
  end

  defp report_failure(state, _reason), do: state

  defp connect_peer(state), do: state |> start_peer(state.address) |> elem(1)

  defp start_peer(state, address) do
    send_queue = SendQueue.new()

    {:ok, pid} =
      Peer.start_link(
        socket: self(),
        owner: state.owner,
        address: address,
        type: state.type,
        subscriptions: state.opts[:subscriptions] || [],
        high_water_mark: state.opts[:high_water_mark],
        max_bytes: state.opts[:most],
        send_queue: send_queue,
        unread_counter: state.unread_counter
      )

    {pid,
     %{
       state
       | peers: Map.put(state.peers, pid, %{open?: false, prefixes: [], send_queue: send_queue})
     }}
  end
end

defmodule Situ.Link.Rendezvous.Server do
  @moduledoc false
  # Runs the server at which processes find one another. One process handles all clients, since each sends little.
  # When a client leaves, its processes are removed. A client that does not read is disconnected.
  #
  # Clients are not authenticated, so none may keep others out. A client must send its greeting within some seconds, and
  # complete each message as quickly. When the server is full, it disconnects the oldest client that has announced
  # nothing.
  use GenServer
  alias Situ.Error
  alias Situ.Link.Rendezvous.{Directory, Protocol}

  @max_clients 1_000
  # Limits for one update, and for all incomplete updates together.
  @max_bytes 1024 * 1024
  @max_pending 16 * 1024 * 1024
  @check_ms 1_000

  defstruct [:listener, :deadline, pending: 0, clients: %{}, directory: Directory.new()]

  @spec start_link(keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def start_link(opts) do
    options = [:binary, active: false, reuseaddr: true, nodelay: true, backlog: 128]

    options =
      options ++ [send_timeout: 1_000, send_timeout_close: true] ++ Situ.TcpKeepalive.options()

    with {:ok, ip} <- :inet.getaddr(String.to_charlist(opts[:interface]), :inet),
         {:ok, listener} <- :gen_tcp.listen(opts[:port], [ip: ip] ++ options) do
      {:ok, server} = GenServer.start_link(__MODULE__, {listener, opts[:deadline]})

      :ok = :gen_tcp.controlling_process(listener, server)
      GenServer.call(server, :begin)
      {:ok, server}
    else
      {:error, :eaddrinuse} ->
        {:error,
         Error.new(:address_in_use, "port #{opts[:port]} is in use", fix: "choose another port")}

      {:error, reason} ->
        {:error,
         Error.new(:bad_address, "cannot listen on #{opts[:interface]}:#{opts[:port]}",
           why: to_string(:inet.format_error(reason))
         )}
    end
  end

  @impl true
  def init({listener, deadline}) do
    Process.flag(:trap_exit, true)
    Process.send_after(self(), :check, min(@check_ms, deadline))
    {:ok, %__MODULE__{listener: listener, deadline: deadline}}
  end

  @impl true
  def handle_call(:begin, _from, state) do
    {server, listener} = {self(), state.listener}
    spawn_link(fn -> accept_clients(listener, server) end)
    {:reply, :ok, state}
  end

  def handle_call(:port, _from, state), do: {:reply, elem(:inet.port(state.listener), 1), state}

  def handle_call(:processes, _from, state),
    do: {:reply, Directory.list_processes(state.directory), state}

  # A client has: `stage` (:greeting or :open), `parser` (the function that reads its next bytes), `bytes` of the
  # current update, `due_since` (when the current update began, or `nil`), and `connected_ms`.
  @impl true
  def handle_info({:client, socket}, state) do
    state = make_room(state)

    if map_size(state.clients) < @max_clients do
      :ok = :inet.setopts(socket, active: :once)
      now = now_ms()
      client = %{stage: :greeting, parser: nil, bytes: 0, due_since: now, connected_ms: now}
      {:noreply, %{state | clients: Map.put(state.clients, socket, client)}}
    else
      :gen_tcp.close(socket)
      {:noreply, state}
    end
  end

  def handle_info({:tcp, socket, bytes}, state) when is_map_key(state.clients, socket) do
    _ = :inet.setopts(socket, active: :once)
    {:noreply, handle_bytes(state, socket, state.clients[socket], bytes)}
  end

  def handle_info(:check, state) do
    Process.send_after(self(), :check, min(@check_ms, state.deadline))
    oldest = now_ms() - state.deadline

    slow =
      for {socket, %{due_since: due_since}} <- state.clients,
          due_since != nil and due_since <= oldest,
          do: socket

    {:noreply, Enum.reduce(slow, state, &disconnect_client(&2, &1))}
  end

  def handle_info({:tcp_closed, socket}, state), do: {:noreply, remove_client(state, socket)}
  def handle_info({:tcp_error, socket, _}, state), do: {:noreply, remove_client(state, socket)}
  def handle_info({:EXIT, _, reason}, state), do: {:stop, reason, state}
  def handle_info(_other, state), do: {:noreply, state}

  defp make_room(%{clients: clients} = state) when map_size(clients) < @max_clients, do: state

  defp make_room(%{clients: clients} = state) do
    owners = Directory.list_owners(state.directory)

    idle =
      for {socket, client} <- clients, socket not in owners, do: {client.connected_ms, socket}

    case Enum.min(idle, fn -> nil end) do
      {_connected_ms, socket} -> disconnect_client(state, socket)
      nil -> state
    end
  end

  # A client with a different version receives ours, as it expects, and is disconnected.
  defp handle_bytes(state, socket, %{stage: :greeting} = client, bytes) do
    case (client.parser || "") <> bytes do
      <<version::little-signed-16, rest::binary>> ->
        greet_client(state, socket, {client, version}, rest)

      short ->
        put_client(state, socket, %{client | parser: short})
    end
  end

  defp handle_bytes(state, socket, client, ""), do: put_client(state, socket, client)

  defp handle_bytes(state, socket, %{bytes: previous} = client, bytes) do
    client = %{client | bytes: previous + byte_size(bytes)}

    case (client.parser || (&Protocol.feed/1)).(bytes) do
      {:ok, :disconnect, _rest} ->
        disconnect_client(state, socket)

      {:ok, update, rest} ->
        {updates, directory} = Directory.apply_update(state.directory, socket, update)
        client = %{client | parser: nil, bytes: 0, due_since: nil}

        %{state | directory: directory}
        |> put_client(socket, client)
        |> broadcast_updates(updates)
        |> handle_bytes(socket, client, rest)

      {:more, parser} ->
        put_pending_client(state, socket, %{
          client
          | parser: parser,
            due_since: client.due_since || now_ms()
        })

      {:error, _why} ->
        disconnect_client(state, socket)
    end
  end

  defp greet_client(state, socket, {client, version}, rest) do
    _ = :gen_tcp.send(socket, <<Protocol.protocol_version()::little-signed-16>>)

    if version == Protocol.protocol_version() do
      client = %{client | stage: :open, parser: nil, due_since: nil}

      state
      |> put_client(socket, client)
      |> send_welcome(socket)
      |> handle_bytes(socket, client, rest)
    else
      disconnect_client(state, socket)
    end
  end

  defp put_pending_client(state, socket, client) do
    state = put_client(state, socket, client)

    if client.bytes > @max_bytes or state.pending > @max_pending,
      do: disconnect_client(state, socket),
      else: state
  end

  defp put_client(state, socket, client) do
    previous = with %{bytes: bytes} <- state.clients[socket], do: bytes
    pending = state.pending + client.bytes - (previous || 0)
    %{state | pending: pending, clients: Map.put(state.clients, socket, client)}
  end

  defp send_welcome(state, socket) do
    address =
      with {:ok, {ip, _}} <- :inet.peername(socket),
           do: to_string(:inet.ntoa(ip)),
           else: (_ -> "")

    processes = Directory.list_processes(state.directory)
    updates = for process <- processes, do: Protocol.encode({:add, process})

    _ =
      :gen_tcp.send(socket, [
        Protocol.encode_text(address),
        <<length(processes)::little-signed-32>> | updates
      ])

    state
  end

  # Updates go to all clients, including the one that sent them, as in the reference implementation.
  defp broadcast_updates(state, []), do: state

  defp broadcast_updates(state, updates) do
    bytes = Enum.map(updates, &Protocol.encode/1)
    for {socket, %{stage: :open}} <- state.clients, do: :gen_tcp.send(socket, bytes)
    state
  end

  defp disconnect_client(state, socket) do
    :gen_tcp.close(socket)
    remove_client(state, socket)
  end

  defp remove_client(state, socket) do
    {updates, directory} = Directory.remove_owner(state.directory, socket)
    {client, clients} = Map.pop(state.clients, socket)
    pending = state.pending - if(client, do: client.bytes, else: 0)

    broadcast_updates(
      %{state | clients: clients, pending: pending, directory: directory},
      updates
    )
  end

  defp now_ms, do: System.monotonic_time(:millisecond)

  @impl true
  def terminate(_reason, state) do
    for {socket, _} <- state.clients, do: :gen_tcp.close(socket)
    :gen_tcp.close(state.listener)
  end

  # Runs in a separate process.
  defp accept_clients(listener, server) do
    case :gen_tcp.accept(listener) do
      {:ok, socket} ->
        with :ok <- :gen_tcp.controlling_process(socket, server),
             do: send(server, {:client, socket})

        accept_clients(listener, server)

      {:error, :emfile} ->
        Process.sleep(100)
        accept_clients(listener, server)

      {:error, _closed} ->
        :ok
    end
  end
end

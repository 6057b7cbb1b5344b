defmodule Situ.Remote.Rendezvous.Server do
  @moduledoc false
  # Where processes find one another. All clients in one process: each has little to say. A client that has gone takes
  # its processes along; one that does not read is let go.
  use GenServer
  alias Situ.Error
  alias Situ.Remote.Rendezvous.{Directory, Wire}

  @most_clients 1_000
  @most_bytes 1024 * 1024
  # Linux: a host that is silent for 25 s is gone (TCP_KEEPIDLE, TCP_KEEPINTVL, TCP_KEEPCNT).
  @alive [
    {:raw, 6, 4, <<10::native-32>>},
    {:raw, 6, 5, <<5::native-32>>},
    {:raw, 6, 6, <<3::native-32>>}
  ]

  defstruct [:listener, clients: %{}, directory: Directory.new()]

  @spec start_link(keyword()) :: {:ok, pid()} | {:error, Error.t()}
  def start_link(opts) do
    options = [:binary, active: false, reuseaddr: true, nodelay: true, keepalive: true]
    options = options ++ [send_timeout: 1_000, send_timeout_close: true, backlog: 128] ++ @alive

    with {:ok, ip} <- :inet.getaddr(String.to_charlist(opts[:interface]), :inet),
         {:ok, listener} <- :gen_tcp.listen(opts[:port], [ip: ip] ++ options) do
      {:ok, server} = GenServer.start_link(__MODULE__, listener)
      :ok = :gen_tcp.controlling_process(listener, server)
      GenServer.call(server, :begin)
      {:ok, server}
    else
      {:error, :eaddrinuse} ->
        {:error,
         Error.new(:address_in_use, "port #{opts[:port]} is in use", fix: "choose another")}

      {:error, reason} ->
        {:error,
         Error.new(:bad_address, "cannot listen on #{opts[:interface]}:#{opts[:port]}",
           why: to_string(:inet.format_error(reason))
         )}
    end
  end

  @impl true
  def init(listener) do
    Process.flag(:trap_exit, true)
    {:ok, %__MODULE__{listener: listener}}
  end

  @impl true
  def handle_call(:begin, _from, state) do
    {server, listener} = {self(), state.listener}
    spawn_link(fn -> accept(listener, server) end)
    {:reply, :ok, state}
  end

  def handle_call(:port, _from, state), do: {:reply, elem(:inet.port(state.listener), 1), state}

  def handle_call(:processes, _from, state),
    do: {:reply, Directory.processes(state.directory), state}

  @impl true
  def handle_info({:client, socket}, state) when map_size(state.clients) < @most_clients do
    :ok = :inet.setopts(socket, active: :once)
    {:noreply, %{state | clients: Map.put(state.clients, socket, {:greeting, ""})}}
  end

  def handle_info({:client, socket}, state) do
    :gen_tcp.close(socket)
    {:noreply, state}
  end

  def handle_info({:tcp, socket, bytes}, state) when is_map_key(state.clients, socket) do
    {stage, buffer} = state.clients[socket]
    _ = :inet.setopts(socket, active: :once)
    {:noreply, read(state, socket, stage, buffer <> bytes)}
  end

  def handle_info({:tcp_closed, socket}, state), do: {:noreply, gone(state, socket)}
  def handle_info({:tcp_error, socket, _}, state), do: {:noreply, gone(state, socket)}
  def handle_info({:EXIT, _, reason}, state), do: {:stop, reason, state}
  def handle_info(_other, state), do: {:noreply, state}

  defp read(state, socket, _stage, buffer) when byte_size(buffer) > @most_bytes,
    do: drop(state, socket)

  # A client of another version gets our version, as it expects, and is disconnected.
  defp read(state, socket, :greeting, <<version::little-signed-16, rest::binary>>) do
    _ = :gen_tcp.send(socket, <<Wire.version()::little-signed-16>>)

    if version == Wire.version(),
      do: state |> welcome(socket) |> read(socket, :open, rest),
      else: drop(state, socket)
  end

  defp read(state, socket, :greeting, short), do: keep(state, socket, :greeting, short)

  defp read(state, socket, :open, buffer) do
    case Wire.decode(buffer) do
      {:ok, :disconnect, _rest} ->
        drop(state, socket)

      {:ok, update, rest} ->
        {told, directory} = Directory.apply(state.directory, socket, update)
        %{state | directory: directory} |> tell(told) |> read(socket, :open, rest)

      :more ->
        keep(state, socket, :open, buffer)

      {:error, _why} ->
        drop(state, socket)
    end
  end

  defp keep(state, socket, stage, buffer),
    do: %{state | clients: Map.put(state.clients, socket, {stage, buffer})}

  defp welcome(state, socket) do
    address =
      with {:ok, {ip, _}} <- :inet.peername(socket),
           do: to_string(:inet.ntoa(ip)),
           else: (_ -> "")

    processes = Directory.processes(state.directory)
    updates = for process <- processes, do: Wire.encode({:add, process})

    _ =
      :gen_tcp.send(socket, [
        Wire.text(address),
        <<length(processes)::little-signed-32>> | updates
      ])

    keep(state, socket, :open, "")
  end

  # To everybody, the one that said it included, as in the reference.
  defp tell(state, []), do: state

  defp tell(state, updates) do
    bytes = Enum.map(updates, &Wire.encode/1)
    for {socket, {:open, _}} <- state.clients, do: :gen_tcp.send(socket, bytes)
    state
  end

  defp drop(state, socket) do
    :gen_tcp.close(socket)
    gone(state, socket)
  end

  defp gone(state, socket) do
    {told, directory} = Directory.gone(state.directory, socket)
    tell(%{state | clients: Map.delete(state.clients, socket), directory: directory}, told)
  end

  @impl true
  def terminate(_reason, state) do
    for {socket, _} <- state.clients, do: :gen_tcp.close(socket)
    :gen_tcp.close(state.listener)
  end

  # Runs in a process of its own.
  defp accept(listener, server) do
    case :gen_tcp.accept(listener) do
      {:ok, socket} ->
        with :ok <- :gen_tcp.controlling_process(socket, server),
             do: send(server, {:client, socket})

        accept(listener, server)

      {:error, :emfile} ->
        Process.sleep(100)
        accept(listener, server)

      {:error, _closed} ->
        :ok
    end
  end
end

defmodule Situ.Link.Server do
  @moduledoc """
  Listens for clients and starts a separate process for each. `Situ.Link.serve/2` starts a server.

      {:ok, server} = Situ.Link.serve("recordings/lobby", port: 0)
      Situ.Link.Server.address(server, "lobby")          # "situ://127.0.0.1:40123/lobby"
      Situ.Link.Server.close(server, 5_000)

  The server limits the number of clients, in total and per address, and how often an address may try a wrong token. A
  client that sends invalid data, sends nothing, or does not read loses its connection. Other clients are not affected.
  """
  use GenServer
  alias Situ.Error
  alias Situ.Link.Address
  alias Situ.Link.Wire.Socket
  alias Situ.Link.Server.Session

  @max_clients 1_000
  @max_per_address 250
  # This many rejected clients at a time are sent the reason; the connections of further ones are just closed.
  @max_refusals 50
  # The limit of wrong tokens from one address within a minute.
  @max_guesses 20
  @minute_ms 60_000

  defstruct [
    :config,
    listeners: [],
    sessions: %{},
    refusals: MapSet.new(),
    guesses: %{},
    refused: 0
  ]

  # Opens the listeners. `config` holds the settings of the sessions: `served`, `token`, `quota`, `now`.
  @doc false
  @spec start_link([{:tcp | :tls | :unix, keyword()}], map()) ::
          {:ok, pid()} | {:error, Error.t()}
  def start_link(listens, config) do
    with {:ok, listeners} <- listen_all(listens, []) do
      {:ok, server} = GenServer.start_link(__MODULE__, config)
      for {_, listener} <- listeners, do: :ok = Socket.set_owner(listener, server)
      GenServer.call(server, {:listen, listeners})
      {:ok, server}
    end
  end

  defp listen_all([], listeners), do: {:ok, Enum.reverse(listeners)}

  defp listen_all([{kind, opts} | rest], listeners) do
    case Socket.listen(kind, opts) do
      {:ok, listener} ->
        listen_all(rest, [{kind, listener} | listeners])

      {:error, error} ->
        for {_, listener} <- listeners, do: Socket.close(listener)
        {:error, error}
    end
  end

  @doc "Returns the port that the server listens on, or `nil` without TCP and TLS."
  @spec port(GenServer.server()) :: :inet.port_number() | nil
  def port(server), do: GenServer.call(server, :port)

  @doc """
  Returns the address of the recording or streams served under `name`, with the fingerprint of the server's certificate.
  Returns `nil` without TCP and TLS. If the server listens on all interfaces, the address contains the hostname of this
  machine.
  """
  @spec address(GenServer.server(), String.t()) :: String.t() | nil
  def address(server, name), do: GenServer.call(server, {:address, name})

  @doc "Returns the server's state: its clients, with the amounts sent to each, and the number of rejected clients."
  @spec info(GenServer.server()) :: map()
  def info(server) do
    {sessions, refused} = GenServer.call(server, :sessions)
    clients = for session <- sessions, info <- call_session(session, :info), do: info
    %{clients: clients, refused: refused}
  end

  defp call_session(session, request) do
    [GenServer.call(session, request, 30_000)]
  catch
    :exit, _ -> []
  end

  @doc "Waits up to `timeout` ms until clients have received all available data, then closes the server."
  @spec close(GenServer.server(), non_neg_integer()) :: :ok
  def close(server, timeout \\ 0) do
    deadline = System.monotonic_time(:millisecond) + timeout

    poll_until(deadline, fn ->
      Enum.all?(list_sessions(server), &(call_session(&1, :drained?) != [false]))
    end)

    if timeout > 0, do: Enum.each(list_sessions(server), &call_session(&1, :finish))
    poll_until(deadline, fn -> list_sessions(server) == [] end)
    GenServer.stop(server, :normal, 30_000)
  catch
    :exit, _ -> :ok
  end

  defp list_sessions(server), do: server |> GenServer.call(:sessions) |> elem(0)

  defp poll_until(deadline, condition) do
    if System.monotonic_time(:millisecond) < deadline and not condition.() do
      Process.sleep(5)
      poll_until(deadline, condition)
    end
  end

  @impl true
  def init(config) do
    Process.flag(:trap_exit, true)
    {:ok, %__MODULE__{config: Map.put(config, :server, self())}}
  end

  @impl true
  def handle_call({:listen, listeners}, _from, state) do
    server = self()
    for {_, listener} <- listeners, do: spawn_link(fn -> accept_clients(listener, server) end)
    {:reply, :ok, %{state | listeners: listeners}}
  end

  def handle_call(:port, _from, state), do: {:reply, listening_port(state), state}

  def handle_call({:address, name}, _from, %{config: config} = state) do
    {:reply,
     with(port when port != nil <- listening_port(state), do: public_address(config, port, name)),
     state}
  end

  def handle_call(:sessions, _from, state),
    do: {:reply, {Map.keys(state.sessions), state.refused}, state}

  def handle_call({:session, peer}, _from, state) do
    cond do
      too_many_guesses?(state, peer) -> {:reply, :full, %{state | refused: state.refused + 1}}
      at_capacity?(state, peer) -> turn_away(state)
      true -> admit_session(state, peer)
    end
  end

  defp admit_session(state, peer) do
    {:ok, session} = Session.start_link(state.config)
    {:reply, {:ok, session}, %{state | sessions: Map.put(state.sessions, session, peer)}}
  end

  defp turn_away(%{refusals: refusals} = state) do
    if MapSet.size(refusals) < @max_refusals do
      {:ok, session} = Session.start_link(Map.put(state.config, :refusal, full_error()))

      {:reply, {:ok, session}, %{state | refusals: MapSet.put(refusals, session)}}
    else
      {:reply, :full, %{state | refused: state.refused + 1}}
    end
  end

  defp full_error do
    Error.new(:too_many_clients, "the server of the link has no room for another client",
      why:
        "it accepts #{@max_clients} clients in total, and #{@max_per_address} from one address",
      fix: "close unused links, or try again later"
    )
  end

  defp listening_port(state),
    do: Enum.find_value(state.listeners, fn {_, listener} -> Socket.port(listener) end)

  defp public_address(config, port, name) do
    Address.to_string(%Address{
      transport: config.transport,
      host: if(config.interface in ["0.0.0.0", "::"], do: host_name(), else: config.interface),
      port: port,
      fingerprint: config.fingerprint,
      name: name
    })
  end

  defp host_name do
    {:ok, name} = :inet.gethostname()
    to_string(name)
  end

  defp at_capacity?(state, peer) do
    map_size(state.sessions) >= @max_clients or
      Enum.count(state.sessions, fn {_, other} -> other == peer end) >= @max_per_address
  end

  defp too_many_guesses?(state, peer),
    do: length(recent_wrong_tokens(state, peer)) >= @max_guesses

  defp recent_wrong_tokens(state, peer) do
    now = System.monotonic_time(:millisecond)
    state.guesses |> Map.get(peer, []) |> Enum.filter(&(now - &1 < @minute_ms))
  end

  @impl true
  def handle_info({:refused, session, code}, state) do
    state = %{state | refused: state.refused + 1}
    peer = state.sessions[session]

    if code == :wrong_token and peer != nil do
      times = [System.monotonic_time(:millisecond) | recent_wrong_tokens(state, peer)]
      {:noreply, %{state | guesses: Map.put(limit_wrong_tokens(state.guesses), peer, times)}}
    else
      {:noreply, state}
    end
  end

  def handle_info({:EXIT, pid, _reason}, state) when is_map_key(state.sessions, pid),
    do: {:noreply, %{state | sessions: Map.delete(state.sessions, pid)}}

  # An acceptor ends with its listener, and the server with the process that started it.
  def handle_info({:EXIT, pid, reason}, %{refusals: refusals} = state) do
    if MapSet.member?(refusals, pid),
      do: {:noreply, %{state | refusals: MapSet.delete(refusals, pid)}},
      else: {:stop, reason, state}
  end

  # Bounds the memory that an attacker with many addresses can use.
  defp limit_wrong_tokens(guesses) when map_size(guesses) < 10_000, do: guesses
  defp limit_wrong_tokens(_wrong), do: %{}

  @impl true
  def terminate(_reason, state) do
    for session <- Map.keys(state.sessions) ++ MapSet.to_list(state.refusals),
        do: Process.exit(session, :shutdown)

    for {kind, listener} <- state.listeners do
      Socket.close(listener)
      if kind == :unix and state.config[:path], do: File.rm(state.config[:path])
    end
  end

  # Runs in a separate process.
  defp accept_clients(listener, server) do
    case Socket.accept(listener) do
      {:ok, socket} ->
        _ = admit_client(socket, server)
        accept_clients(listener, server)

      {:error, reason} when reason in [:emfile, :enfile, :econnaborted, :timeout] ->
        Process.sleep(100)
        accept_clients(listener, server)

      {:error, _closed} ->
        :ok
    end
  end

  defp admit_client(socket, server) do
    with {:ok, peer} <- Socket.peer_address(socket),
         {:ok, session} <- GenServer.call(server, {:session, peer}, :infinity) do
      Session.adopt_socket(session, socket)
    else
      _full_or_gone -> Socket.close(socket)
    end
  end
end

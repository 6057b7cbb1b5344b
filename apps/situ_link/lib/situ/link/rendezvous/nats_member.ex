defmodule Situ.Link.Rendezvous.NatsMember do
  @moduledoc false
  # Lets processes find one another over NATS, without a server of Situ. On `situ.peers` each process publishes its
  # endpoints when it joins, when they change and every `beat`, in the format of the rendezvous protocol. A newcomer
  # publishes the farewell byte, and all other processes then publish their endpoints. On `situ.peer.NAME` a process
  # replies with the address of its link.
  #
  # The reply subject identifies the process that sent a message. If two have the same name, the first counts until it
  # leaves. Both are notified; `rival` is the time at which the other process was last heard.
  use GenServer
  require Logger
  alias Situ.Error
  alias Situ.Link.Nats.{Connection, Servers}
  alias Situ.Link.Rendezvous.{Directory, Protocol}

  @all "situ.peers"
  @again_ms 1_000
  @most 1_000
  @find_ms 1_000

  defstruct [:own, :listener, :beat, :start, :id, :connection, :error, :rival, peers: %{}]

  @spec start_link(keyword()) :: GenServer.on_start() | {:error, Error.t()}
  def start_link(opts) do
    with {:ok, _servers, _login} <- Servers.parse(opts[:address]),
         do: GenServer.start_link(__MODULE__, opts)
  end

  @doc "Finds the address of the link that the process `name` offers. Returns `nil` if there is none, or no connection."
  @spec find_address(String.t(), String.t()) :: String.t() | nil
  def find_address(server, name) do
    with {:ok, servers, login} <- Servers.parse(server),
         {:ok, connection} <-
           Connection.start(servers: servers, login: fn -> login end, jetstream: false) do
      answer = Connection.request(connection, peer_subject(name), [], "", @find_ms)
      GenServer.stop(connection)

      case answer do
        {:ok, %{status: nil, data: address}} when address != "" -> address
        _nobody -> nil
      end
    else
      {:error, _} -> nil
    end
  end

  # Escapes the name so that it is always a single token.
  defp peer_subject(name),
    do: "situ.peer." <> URI.encode(name, &(&1 in ?a..?z or &1 in ?A..?Z or &1 in ?0..?9))

  @impl true
  def init(opts) do
    Process.flag(:trap_exit, true)
    {:ok, servers, login} = Servers.parse(opts[:address])
    own = %{name: opts[:name], version: opts[:version], endpoints: opts[:endpoints]}
    subjects = [@all, peer_subject(own.name)]

    start = [
      servers: servers,
      login: fn -> login end,
      tls: opts[:tls],
      jetstream: false,
      subjects: subjects
    ]

    id = "_INBOX.peer." <> Base.encode16(:crypto.strong_rand_bytes(10))
    start_connecting(start)
    Process.send_after(self(), :beat, opts[:beat])

    {:ok,
     %__MODULE__{own: own, listener: opts[:listener], beat: opts[:beat], start: start, id: id}}
  end

  # Connects in a separate process, because an unresponsive address takes seconds.
  defp start_connecting(opts) do
    me = self()

    spawn_link(fn ->
      case Connection.start([subscriber: me] ++ opts) do
        {:ok, connection} -> send(me, {:connected, connection})
        {:error, {:shutdown, %Error{} = error}} -> send(me, {:failed, Exception.message(error)})
        {:error, reason} -> send(me, {:failed, inspect(reason, limit: 5)})
      end
    end)
  end

  @impl true
  def handle_call(:peers, _from, state),
    do: {:reply, for({_, {_, _, process}} <- Enum.sort(state.peers), do: process), state}

  def handle_call(:error, _from, state) do
    taken = if state.rival, do: Directory.name_taken_text(state.own.name)
    {:reply, state.error || taken, state}
  end

  def handle_call({:announce, endpoints}, _from, state) do
    state = %{state | own: %{state.own | endpoints: endpoints}}
    publish_update(state, {:add, state.own})
    {:reply, :ok, state}
  end

  @impl true
  def handle_info({:connected, connection}, state) do
    Process.link(connection)
    {:noreply, announce_arrival(%{state | connection: connection, error: nil})}
  end

  def handle_info({:failed, why}, state) do
    Process.send_after(self(), :connect, @again_ms)
    {:noreply, %{state | error: why}}
  end

  def handle_info(:connect, state) do
    start_connecting(state.start)
    {:noreply, state}
  end

  # The connection was lost and has been restored.
  def handle_info({:nats, connection, :up}, %{connection: connection} = state),
    do: {:noreply, announce_arrival(state)}

  def handle_info({:nats, _, %{subject: @all, reply: id}}, %{id: id} = state),
    do: {:noreply, state}

  def handle_info({:nats, _, %{subject: @all} = message}, state) do
    case Protocol.decode(message.data) do
      {:ok, update, ""} -> {:noreply, handle_update(state, update, message.reply)}
      _noise -> {:noreply, state}
    end
  end

  def handle_info({:nats, connection, %{reply: reply}}, state) when is_binary(reply) do
    addresses = for {:address, address, _streams} <- state.own.endpoints, do: address
    Connection.publish(connection, reply, state.id, List.first(addresses) || "")
    {:noreply, state}
  end

  def handle_info(:beat, state) do
    Process.send_after(self(), :beat, state.beat)
    publish_update(state, {:add, state.own})
    late = now_ms() - div(state.beat * 7, 2)
    {gone, kept} = Enum.split_with(state.peers, fn {_, {_, seen, _}} -> seen < late end)
    for {name, _} <- gone, do: notify_listener(state, {:removed, name})
    rival = if state.rival && state.rival >= late, do: state.rival
    {:noreply, %{state | peers: Map.new(kept), rival: rival}}
  end

  def handle_info({:EXIT, connection, reason}, %{connection: connection} = state) do
    start_connecting(state.start)
    {:noreply, %{state | connection: nil, error: inspect(reason, limit: 5)}}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp announce_arrival(state) do
    publish_update(state, :disconnect)
    publish_update(state, {:add, state.own})
    state
  end

  defp publish_update(%{connection: nil}, _update), do: :ok

  defp publish_update(state, update),
    do: Connection.publish(state.connection, @all, state.id, Protocol.encode(update))

  defp handle_update(state, :disconnect, _who) do
    publish_update(state, {:add, state.own})
    state
  end

  defp handle_update(%{own: %{name: name}} = state, {:add, %{name: name}}, _who) do
    if state.rival == nil do
      Logger.warning("situ rendezvous: " <> Directory.name_taken_text(name))
      notify_listener(state, {:taken, name})
    end

    %{state | rival: now_ms()}
  end

  defp handle_update(%{own: %{name: name}} = state, {:remove, name}, _who),
    do: %{state | rival: nil}

  defp handle_update(state, {:add, %{name: name} = process}, who) do
    case state.peers do
      %{^name => {^who, _seen, ^process}} ->
        put_peer(state, who, process)

      %{^name => {^who, _seen, _other}} ->
        notify_listener(state, {:removed, name})
        notify_listener(state, {:added, process})
        put_peer(state, who, process)

      %{^name => _somebody_elses} ->
        state

      peers when map_size(peers) >= @most ->
        state

      _ ->
        notify_listener(state, {:added, process})
        put_peer(state, who, process)
    end
  end

  defp handle_update(state, {:remove, name}, who) do
    case state.peers do
      %{^name => {^who, _, _}} ->
        notify_listener(state, {:removed, name})
        %{state | peers: Map.delete(state.peers, name)}

      _ ->
        state
    end
  end

  defp put_peer(state, who, process),
    do: %{state | peers: Map.put(state.peers, process.name, {who, now_ms(), process})}

  defp notify_listener(%{listener: nil}, _event), do: :ok
  defp notify_listener(state, event), do: send(state.listener, {:situ_rendezvous, self(), event})

  defp now_ms, do: System.monotonic_time(:millisecond)

  @impl true
  def terminate(_reason, %{connection: nil}), do: :ok

  def terminate(_reason, state) do
    publish_update(state, {:remove, state.own.name})
    GenServer.stop(state.connection)
  catch
    :exit, _ -> :ok
  end
end

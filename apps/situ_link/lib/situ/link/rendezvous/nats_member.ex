defmodule Situ.Link.Rendezvous.NatsMember do
  @moduledoc false
  # Lets processes find one another over NATS, without a server of Situ. On `situ.peers` each process publishes its
  # endpoints when it joins, when they change and every `beat_ms`, in the format of the rendezvous protocol. A newcomer
  # publishes the farewell byte, and all other processes then publish their endpoints. On `situ.peer.NAME` a process
  # replies with the address of its link.
  #
  # The reply subject identifies the process that sent a message. If two have the same name, the first counts until it
  # leaves. Both are notified; `rival_ms` is the time at which the other process was last heard.
  use GenServer
  require Logger
  alias Situ.Error
  alias Situ.Link.Nats.{Connection, Servers}
  alias Situ.Link.Rendezvous.{Directory, Protocol}

  @subject "situ.peers"
  @retry_ms 1_000
  @max_peers 1_000
  @find_ms 1_000

  defstruct [
    :entry,
    :listener,
    :beat_ms,
    :settings,
    :id,
    :connection,
    :error,
    :rival_ms,
    peers: %{}
  ]

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
      result = Connection.request(connection, peer_subject(name), [], "", @find_ms)
      GenServer.stop(connection)

      case result do
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
    entry = %{name: opts[:name], version: opts[:version], endpoints: opts[:endpoints]}
    subjects = [@subject, peer_subject(entry.name)]

    settings = [
      servers: servers,
      login: fn -> login end,
      tls: opts[:tls],
      jetstream: false,
      subjects: subjects
    ]

    id = "_INBOX.peer." <> Base.encode16(:crypto.strong_rand_bytes(10))
    start_connecting(settings)
    Process.send_after(self(), :beat, opts[:beat])

    {:ok,
     %__MODULE__{
       entry: entry,
       listener: opts[:listener],
       beat_ms: opts[:beat],
       settings: settings,
       id: id
     }}
  end

  # Connects in a separate process, because an unresponsive address takes seconds.
  defp start_connecting(opts) do
    member = self()

    spawn_link(fn ->
      case Connection.start([subscriber: member] ++ opts) do
        {:ok, connection} ->
          send(member, {:connected, connection})

        {:error, {:shutdown, %Error{} = error}} ->
          send(member, {:failed, Exception.message(error)})

        {:error, reason} ->
          send(member, {:failed, inspect(reason, limit: 5)})
      end
    end)
  end

  @impl true
  def handle_call(:peers, _from, state),
    do: {:reply, for({_, {_, _, process}} <- Enum.sort(state.peers), do: process), state}

  def handle_call(:error, _from, state) do
    conflict = if state.rival_ms, do: Directory.name_taken_text(state.entry.name)
    {:reply, state.error || conflict, state}
  end

  def handle_call({:announce, endpoints}, _from, state) do
    state = %{state | entry: %{state.entry | endpoints: endpoints}}
    publish_update(state, {:add, state.entry})
    {:reply, :ok, state}
  end

  @impl true
  def handle_info({:connected, connection}, state) do
    Process.link(connection)
    {:noreply, announce_arrival(%{state | connection: connection, error: nil})}
  end

  def handle_info({:failed, why}, state) do
    Process.send_after(self(), :connect, @retry_ms)
    {:noreply, %{state | error: why}}
  end

  def handle_info(:connect, state) do
    start_connecting(state.settings)
    {:noreply, state}
  end

  # The connection was lost and has been restored.
  def handle_info({:nats, connection, :up}, %{connection: connection} = state),
    do: {:noreply, announce_arrival(state)}

  def handle_info({:nats, _, %{subject: @subject, reply: id}}, %{id: id} = state),
    do: {:noreply, state}

  def handle_info({:nats, _, %{subject: @subject} = message}, state) do
    case Protocol.decode(message.data) do
      {:ok, update, ""} -> {:noreply, handle_update(state, update, message.reply)}
      _noise -> {:noreply, state}
    end
  end

  def handle_info({:nats, connection, %{reply: reply}}, state) when is_binary(reply) do
    addresses = for {:address, address, _streams} <- state.entry.endpoints, do: address
    Connection.publish(connection, reply, state.id, List.first(addresses) || "")
    {:noreply, state}
  end

  def handle_info(:beat, state) do
    Process.send_after(self(), :beat, state.beat_ms)
    publish_update(state, {:add, state.entry})
    oldest = now_ms() - div(state.beat_ms * 7, 2)
    {expired, active} = Enum.split_with(state.peers, fn {_, {_, seen, _}} -> seen < oldest end)
    for {name, _} <- expired, do: notify_listener(state, {:removed, name})
    rival_ms = if state.rival_ms && state.rival_ms >= oldest, do: state.rival_ms
    {:noreply, %{state | peers: Map.new(active), rival_ms: rival_ms}}
  end

  def handle_info({:EXIT, connection, reason}, %{connection: connection} = state) do
    start_connecting(state.settings)
    {:noreply, %{state | connection: nil, error: inspect(reason, limit: 5)}}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp announce_arrival(state) do
    publish_update(state, :disconnect)
    publish_update(state, {:add, state.entry})
    state
  end

  defp publish_update(%{connection: nil}, _update), do: :ok

  defp publish_update(state, update),
    do: Connection.publish(state.connection, @subject, state.id, Protocol.encode(update))

  defp handle_update(state, :disconnect, _sender) do
    publish_update(state, {:add, state.entry})
    state
  end

  defp handle_update(%{entry: %{name: name}} = state, {:add, %{name: name}}, _sender) do
    if state.rival_ms == nil do
      Logger.warning("situ rendezvous: " <> Directory.name_taken_text(name))
      notify_listener(state, {:taken, name})
    end

    %{state | rival_ms: now_ms()}
  end

  defp handle_update(%{entry: %{name: name}} = state, {:remove, name}, _sender),
    do: %{state | rival_ms: nil}

  defp handle_update(state, {:add, %{name: name} = process}, sender) do
    case state.peers do
      %{^name => {^sender, _seen, ^process}} ->
        put_peer(state, sender, process)

      %{^name => {^sender, _seen, _other}} ->
        notify_listener(state, {:removed, name})
        notify_listener(state, {:added, process})
        put_peer(state, sender, process)

      %{^name => _somebody_elses} ->
        state

      peers when map_size(peers) >= @max_peers ->
        state

      _ ->
        notify_listener(state, {:added, process})
        put_peer(state, sender, process)
    end
  end

  defp handle_update(state, {:remove, name}, sender) do
    case state.peers do
      %{^name => {^sender, _, _}} ->
        notify_listener(state, {:removed, name})
        %{state | peers: Map.delete(state.peers, name)}

      _ ->
        state
    end
  end

  defp put_peer(state, sender, process),
    do: %{state | peers: Map.put(state.peers, process.name, {sender, now_ms(), process})}

  defp notify_listener(%{listener: nil}, _event), do: :ok
  defp notify_listener(state, event), do: send(state.listener, {:situ_rendezvous, self(), event})

  defp now_ms, do: System.monotonic_time(:millisecond)

  @impl true
  def terminate(_reason, %{connection: nil}), do: :ok

  def terminate(_reason, state) do
    publish_update(state, {:remove, state.entry.name})
    GenServer.stop(state.connection)
  catch
    :exit, _ -> :ok
  end
end

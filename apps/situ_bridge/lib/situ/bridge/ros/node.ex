defmodule Situ.Bridge.Ros.Node do
  @moduledoc false
  # A ROS node for one end of a topic. It registers with the master, registers again if the master restarts, and handles
  # the calls of other nodes. A subscriber has a link to every publisher; the owner receives their messages.
  #
  #     owner ── Node ─┬─ Registrar          registers the node, and detects that the master was restarted
  #                    ├─ Slave ...          handles one call from the master or a peer
  #                    └─ Link ...           connects to one publisher, and is restarted when it breaks
  use GenServer
  require Logger
  alias Situ.Bridge.Net.Listener
  alias Situ.Bridge.Ros.{Address, PublisherLink, Registrar, SlaveCall}
  alias Situ.Error

  @min_wait_ms 100
  @max_wait_ms 5_000

  defstruct [
    :address,
    :listener,
    :acceptor,
    :owner,
    :role,
    :registrar,
    :uri,
    slaves: MapSet.new(),
    closing_links: MapSet.new(),
    links: %{},
    waits: %{},
    publishers: []
  ]

  @type role ::
          {:publisher, topic :: String.t(), type :: String.t(), :inet.port_number()}
          | {:subscriber, topic :: String.t(), type :: String.t(), link :: map()}

  @doc "Starts a node for the calling process. Errors: `:bad_address`, `:address_in_use`."
  @spec start_link(Address.t(), role()) :: {:ok, pid()} | {:error, Error.t()}
  def start_link(address, role) do
    with {:ok, listener} <- Listener.listen(Address.listen_interface(address), 0) do
      {:ok, node} = GenServer.start_link(__MODULE__, {address, role, listener, self()})
      :ok = :gen_tcp.controlling_process(listener, node)
      send(node, :begin)
      {:ok, node}
    end
  end

  @doc "Unregisters the node from the master and stops it."
  @spec stop(pid()) :: :ok
  def stop(node) do
    GenServer.stop(node, :normal, 10_000)
  catch
    :exit, _ -> :ok
  end

  @impl true
  def init({address, role, listener, owner}) do
    Process.flag(:trap_exit, true)
    uri = "http://#{address.host}:#{Listener.port(listener)}/"
    {:ok, %__MODULE__{address: address, role: role, listener: listener, owner: owner, uri: uri}}
  end

  @impl true
  def handle_call(:adopt, _from, state) do
    node = self()
    {:ok, slave} = SlaveCall.start_link(&GenServer.call(node, {:slave, &1, &2}))
    {:reply, slave, %{state | slaves: MapSet.put(state.slaves, slave)}}
  end

  def handle_call({:slave, method, arguments}, _from, state) do
    {reply, state} = handle_slave_call(method, arguments, state)
    {:reply, reply, state}
  end

  defp handle_slave_call(
         "requestTopic",
         [_caller, topic, _protocols],
         %{role: {:publisher, topic, _type, port}} = state
       ),
       do: {[1, "ready", ["TCPROS", state.address.host, port]], state}

  defp handle_slave_call("requestTopic", _arguments, state),
    do: {[0, "this node does not publish the topic", 0], state}

  defp handle_slave_call(
         "publisherUpdate",
         [_caller, topic, publishers],
         %{role: {:subscriber, topic, _, _}} = state
       )
       when is_list(publishers),
       do: {[1, "", 0], update_links(state, publishers)}

  defp handle_slave_call("getPid", _, state),
    do: {[1, "", System.pid() |> String.to_integer()], state}

  defp handle_slave_call("getMasterUri", _, state), do: {[1, "", state.address.master], state}
  defp handle_slave_call("getBusStats", _, state), do: {[1, "", [[], [], []]], state}
  defp handle_slave_call("getBusInfo", _, state), do: {[1, "", []], state}

  defp handle_slave_call("getPublications", _, state),
    do: {[1, "", list_topics(state.role, :publisher)], state}

  defp handle_slave_call("getSubscriptions", _, state),
    do: {[1, "", list_topics(state.role, :subscriber)], state}

  # The master sends this to the first node when another node takes its name.
  defp handle_slave_call("shutdown", [_caller, why], state) do
    Logger.warning(
      "ROS: the master asks #{state.address.node} to shut down: #{inspect(why, limit: 50)}"
    )

    {[1, "", 0], state}
  end

  defp handle_slave_call(_method, _arguments, state), do: {[1, "", 0], state}

  defp list_topics({role, topic, type, _}, role), do: [[topic, type]]
  defp list_topics(_role, _other), do: []

  @impl true
  def handle_info(:begin, state) do
    registrar = Registrar.start_link(self(), state.address, state.role, state.uri)

    {:noreply,
     %{state | acceptor: Listener.start_acceptor(state.listener, self()), registrar: registrar}}
  end

  def handle_info({:publishers, uris}, state), do: {:noreply, update_links(state, uris)}

  def handle_info({:link, uri}, state) do
    if uri in state.publishers and not is_map_key(state.links, uri),
      do: {:noreply, open_link(state, uri)},
      else: {:noreply, state}
  end

  def handle_info({:received, uri}, state),
    do: {:noreply, %{state | waits: Map.delete(state.waits, uri)}}

  def handle_info({:EXIT, pid, reason}, state) do
    cond do
      MapSet.member?(state.slaves, pid) ->
        {:noreply, %{state | slaves: MapSet.delete(state.slaves, pid)}}

      MapSet.member?(state.closing_links, pid) ->
        {:noreply, %{state | closing_links: MapSet.delete(state.closing_links, pid)}}

      uri = Enum.find_value(state.links, fn {uri, link} -> link == pid && uri end) ->
        {:noreply, schedule_relink(state, uri, reason)}

      true ->
        {:stop, reason, state}
    end
  end

  # A link to a publisher that left ends after its remaining data has been read. New publishers are linked.
  defp update_links(%{role: {:subscriber, _, _, _}} = state, uris) do
    uris = Enum.filter(uris, &is_binary/1)
    {current, closing} = Map.split(state.links, uris)
    closing = Map.values(closing)
    Enum.each(closing, &PublisherLink.close_when_silent/1)
    closing_links = MapSet.union(state.closing_links, MapSet.new(closing))
    waits = Map.take(state.waits, uris)
    state = %{state | links: current, closing_links: closing_links}
    state = %{state | publishers: uris, waits: waits}
    Enum.reduce(uris -- Map.keys(current), state, &open_link(&2, &1))
  end

  defp update_links(state, _uris), do: state

  defp open_link(%{role: {:subscriber, topic, type, options}} = state, uri) do
    {:ok, link} =
      PublisherLink.start_link(
        Map.merge(options, %{
          node: self(),
          owner: state.owner,
          uri: uri,
          topic: topic,
          type: type,
          caller: state.address.node
        })
      )

    %{state | links: Map.put(state.links, uri, link)}
  end

  # The same error is logged once, not at every attempt.
  defp schedule_relink(state, uri, reason) do
    {wait, logged_error} = Map.get(state.waits, uri, {@min_wait_ms, nil})

    if logged_error != reason and reason != {:shutdown, :closed},
      do: Logger.warning("ROS: #{uri}: #{inspect(reason, limit: 10)}")

    Process.send_after(self(), {:link, uri}, wait)
    waits = Map.put(state.waits, uri, {min(wait * 2, @max_wait_ms), reason})
    %{state | links: Map.delete(state.links, uri), waits: waits}
  end

  @impl true
  def terminate(_reason, state) do
    if state.registrar, do: Process.exit(state.registrar, :kill)
    Registrar.unregister_node(state.address, state.role, state.uri)

    for pid <- Map.values(state.links) ++ Enum.concat(state.closing_links, state.slaves),
        do: Process.exit(pid, :shutdown)

    :gen_tcp.close(state.listener)
  end
end

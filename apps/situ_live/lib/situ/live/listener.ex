defmodule Situ.Live.Listener do
  @moduledoc false
  # Owns the port of one server: opens it, publishes its configuration, ends idle connections, and closes everything on
  # shutdown. With `port: :none`, another web server has the port (`Situ.Live.Adapter`) and ends idle connections.
  use GenServer, shutdown: 100_000
  alias Situ.Live.{Connections, Endpoint, PeerLimit, Yaws}

  @sweep_ms 15_000
  # The time between checks, for which one peer may hold all connections. While there are few connections, a check
  # costs nothing (`Situ.Live.PeerLimit`).
  @peers_ms 200
  @idle_ms 90_000

  def start_link(arg), do: GenServer.start_link(__MODULE__, arg)

  @spec get_endpoint(pid()) :: Endpoint.t()
  def get_endpoint(pid), do: GenServer.call(pid, :endpoint)

  # The port must be open, or the error known, when start_link returns.
  @impl true
  def init({config, tls}) do
    Process.flag(:trap_exit, true)
    Endpoint.put_config(config)

    if config.port == :none,
      do: {:ok, %{config: config, sconf: nil, peers: MapSet.new()}},
      else: open_port(config, tls)
  end

  defp open_port(config, tls) do
    case Yaws.open_listener(config.ref, config.ip, config.port, tls) do
      {:ok, sconf} ->
        Process.monitor(:yaws_server)
        schedule_sweep()
        schedule_peer_check()
        {:ok, %{config: config, sconf: sconf, peers: MapSet.new()}}

      {:error, error} ->
        Endpoint.erase_config(config.ref)
        {:stop, error}
    end
  end

  defp schedule_sweep, do: Process.send_after(self(), :sweep, @sweep_ms)

  defp schedule_peer_check, do: Process.send_after(self(), :check_peers, @peers_ms)

  @impl true
  def handle_call(:endpoint, _from, state), do: {:reply, state.config, state}

  @impl true
  def handle_info(:sweep, state) do
    Connections.kill_idle(state.config.ref, @idle_ms)
    schedule_sweep()
    {:noreply, state}
  end

  def handle_info(:check_peers, state) do
    {excess, peers} = PeerLimit.find_excess(state.config.port, state.peers)
    for pid <- excess, pid != self(), do: Process.exit(pid, :kill)
    schedule_peer_check()
    {:noreply, %{state | peers: peers}}
  end

  # A restarted Yaws has lost its ports, so this process must restart, too.
  def handle_info({:DOWN, _, _, _, _}, state),
    do: {:stop, :web_server_down, %{state | sconf: nil}}

  def handle_info(_, state), do: {:noreply, state}

  @impl true
  def terminate(_reason, state) do
    if state.sconf, do: Yaws.close_listener(state.sconf)
    Endpoint.erase_config(state.config.ref)
    for pid <- Connections.list_pids(state.config.ref), do: Process.exit(pid, :shutdown)
  end
end

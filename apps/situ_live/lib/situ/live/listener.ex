defmodule Situ.Live.Listener do
  @moduledoc false
  # Owns the port of one server: opens it, publishes its configuration, ends idle connections, and closes everything on
  # shutdown.
  use GenServer, shutdown: 100_000
  alias Situ.Live.{Connections, Endpoint, Peers, Yaws}

  @sweep_ms 15_000
  # For this long one peer may hold all connections; with few connections a check costs nothing (`Situ.Live.Peers`).
  @crowd_ms 200
  @idle_ms 90_000

  def start_link(arg), do: GenServer.start_link(__MODULE__, arg)

  @spec endpoint(pid()) :: Endpoint.t()
  def endpoint(pid), do: GenServer.call(pid, :endpoint)

  # The port must be open, or the error known, when start_link returns.
  @impl true
  def init({config, tls}) do
    Process.flag(:trap_exit, true)
    Endpoint.put(config)

    case Yaws.add(config.ref, config.ip, config.port, tls) do
      {:ok, sconf} ->
        Process.monitor(:yaws_server)
        crowd_tick()
        {:ok, %{config: config, sconf: sconf, tick: tick(), peers: MapSet.new()}}

      {:error, error} ->
        Endpoint.erase(config.ref)
        {:stop, error}
    end
  end

  defp tick, do: Process.send_after(self(), :sweep, @sweep_ms)

  defp crowd_tick, do: Process.send_after(self(), :crowd, @crowd_ms)

  @impl true
  def handle_call(:endpoint, _from, state), do: {:reply, state.config, state}

  @impl true
  def handle_info(:sweep, state) do
    Connections.sweep(state.config.ref, @idle_ms)
    {:noreply, %{state | tick: tick()}}
  end

  def handle_info(:crowd, state) do
    {excess, peers} = Peers.find_excess(state.config.port, state.peers)
    for pid <- excess, pid != self(), do: Process.exit(pid, :kill)
    crowd_tick()
    {:noreply, %{state | peers: peers}}
  end

  # A restarted Yaws has lost its ports, so this process must restart, too.
  def handle_info({:DOWN, _, _, _, _}, state),
    do: {:stop, :web_server_down, %{state | sconf: nil}}

  def handle_info(_, state), do: {:noreply, state}

  @impl true
  def terminate(_reason, state) do
    if state.sconf, do: Yaws.remove(state.sconf)
    Endpoint.erase(state.config.ref)
    for pid <- Connections.pids(state.config.ref), do: Process.exit(pid, :shutdown)
  end
end

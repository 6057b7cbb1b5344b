defmodule Situ.Phoenix.Studios do
  @moduledoc false
  # Starts the studio of a route at the route's first request, because only a request knows the complete path: the
  # endpoint, scopes and `forward` may each add a part. The table holds the server of each path, so that requests read
  # it without a call to this process.
  use GenServer
  @own_options [:recordings, :hosts, :viewer?]

  def start_link(_), do: GenServer.start_link(__MODULE__, [], name: __MODULE__)

  @doc "Returns the `Situ.Live` server of the studio under `prefix`."
  @spec fetch_server(String.t(), keyword() | mfa()) :: {:ok, pid()} | {:error, Exception.t()}
  def fetch_server(prefix, opts) do
    case :ets.lookup(__MODULE__, prefix) do
      [{_, server}] -> {:ok, server}
      [] -> GenServer.call(__MODULE__, {:start, prefix, opts}, 60_000)
    end
  end

  # `studios` holds the supervisor of each studio by its path. The server of a studio that has restarted is a new
  # process.
  @impl true
  def init(_) do
    :ets.new(__MODULE__, [:named_table, read_concurrency: true])
    {:ok, %{studios: %{}, monitors: %{}}}
  end

  @impl true
  def handle_call({:start, prefix, opts}, _from, state) do
    with [] <- :ets.lookup(__MODULE__, prefix),
         {:ok, studio} <- find_or_start(state.studios[prefix], prefix, opts),
         server when is_pid(server) <- Situ.Studio.live_server(studio) do
      :ets.insert(__MODULE__, {prefix, server})
      monitors = Map.put(state.monitors, Process.monitor(server), prefix)
      studios = Map.put(state.studios, prefix, studio)
      {:reply, {:ok, server}, %{state | studios: studios, monitors: monitors}}
    else
      [{_, server}] ->
        {:reply, {:ok, server}, state}

      {:error, error} ->
        {:reply, {:error, error}, state}

      :restarting ->
        {:reply, {:error, Situ.Error.new(:restarting, "the studio is restarting")}, state}
    end
  end

  defp find_or_start(studio, prefix, opts) do
    if studio && Process.alive?(studio), do: {:ok, studio}, else: start_child(prefix, opts)
  end

  # A studio that has ended is started by the next request.
  defp start_child(prefix, opts) do
    options = [port: :none, prefix: prefix, id: prefix] ++ studio_options(opts)
    spec = Supervisor.child_spec({Situ.Studio, options}, restart: :temporary)

    case DynamicSupervisor.start_child(Situ.Phoenix.StudioSupervisor, spec) do
      # An invalid option raises in the process of the supervisor.
      {:error, {error, _stack}} when is_exception(error) -> {:error, error}
      result -> result
    end
  end

  defp studio_options({module, function, args}), do: studio_options(apply(module, function, args))

  defp studio_options(opts) do
    recordings = if opts[:recordings], do: [path: opts[:recordings]], else: []
    Keyword.drop(opts, @own_options) ++ recordings
  end

  @impl true
  def handle_info({:DOWN, monitor, :process, _, _}, state) do
    {prefix, monitors} = Map.pop!(state.monitors, monitor)
    :ets.delete(__MODULE__, prefix)
    {:noreply, %{state | monitors: monitors}}
  end
end

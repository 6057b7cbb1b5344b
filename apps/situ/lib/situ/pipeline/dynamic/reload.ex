defmodule Situ.Pipeline.Dynamic.Reload do
  @moduledoc false
  # Replaces the functions of a pipeline whose module has a new version. A separate process builds the pipeline again to
  # obtain the new functions, and ends when all stages use them:
  #
  #   process -> server  {:situ_rebuilt, process, {:ok, graph} or :error}
  #   server -> process  {:situ_renewing, count, stages}
  #   stages -> process  {:renewed, reply}, `count` times, through the server
  #
  # A pipeline that is not planned yet renews its graph in `plan`, before any stage can use the old functions.
  alias Situ.Runtime
  alias Situ.Application.CodeReload
  alias Situ.Graph.Builder
  alias Situ.Pipeline.{Dynamic, Handlers, State}
  require Logger

  # A build fails while other modules of the same compilation are not loaded yet.
  @attempts 20
  @pause_ms 100

  @doc "Begins to renew the functions if a version is loaded that the pipeline does not have."
  @spec begin(State.t()) :: State.t()
  def begin(%{settings: %{origin: {module, _} = origin}, code: {version, _process}} = state) do
    case CodeReload.code_version(module) do
      same when same in [nil, version] ->
        state

      new ->
        server = self()
        call = {__MODULE__, :rebuild, [server, origin, state.handle]}
        %{state | code: {new, Runtime.spawn_process(:erlang, "new functions", call, [:link])}}
    end
  end

  def begin(state), do: state

  @doc "Returns the process that renews the functions, or `nil`."
  @spec process(State.t()) :: pid() | nil
  def process(%{code: {_version, process}}), do: process

  @doc """
  Handles the new graph: replaces the functions in the graph. Returns the requests to replace those in the stages; the
  process receives a reply to each.
  """
  @spec finish(State.t(), pid(), {:ok, Situ.Graph.t()} | :error) :: {State.t(), [map()]}
  def finish(%{code: {version, process}} = state, process, result) do
    {module, _} = state.settings.origin
    state = %{state | code: {version, nil}}

    # A graph of an older version must not be used: the VM may have discarded its functions.
    if result == :error or CodeReload.code_version(module) not in [nil, version] do
      send(process, {:situ_renewing, 0, []})
      {begin(state), []}
    else
      renew(state, process, elem(result, 1))
    end
  end

  # A newer version has been loaded in the meantime.
  def finish(state, process, _result) do
    send(process, {:situ_renewing, 0, []})
    {state, []}
  end

  defp renew(state, process, graph) do
    state = %{state | graph: Handlers.replace_handlers(state.graph, graph)}
    {state, stages} = Dynamic.Guarantee.reload(state, graph)
    {state, requests} = Dynamic.Replacement.reload(state, graph)
    send(process, {:situ_renewing, length(requests), stages})
    {state, requests}
  end

  @doc false
  def rebuild(server, origin, handle) do
    Process.put(:situ_pipeline, server)
    send(server, {:situ_rebuilt, self(), build_graph(origin, handle, @attempts)})

    receive do
      {:situ_renewing, count, stages} ->
        for _ <- 1..count//1, do: receive(do: ({:renewed, _reply} -> :ok))
        Enum.each(stages, &await_stage/1)
    end
  end

  # A stage that replies has handled all earlier requests.
  defp await_stage(pid) do
    GenServer.call(pid, :"$estimate_buffered_count", :infinity)
  catch
    :exit, _ -> :ok
  end

  defp build_graph({module, opts} = origin, handle, attempts) do
    {_, graph} = Builder.with_graph(handle, %Situ.Graph{}, fn -> module.build(handle, opts) end)
    {:ok, graph}
  catch
    kind, reason ->
      if attempts > 1 do
        Process.sleep(@pause_ms)
        build_graph(origin, handle, attempts - 1)
      else
        what = Exception.format_banner(kind, reason, __STACKTRACE__)
        Logger.warning("#{inspect(module)} keeps its old functions: #{what}")
        :error
      end
  end
end

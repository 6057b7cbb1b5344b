defmodule Situ.Pipeline.Handlers do
  @moduledoc false
  # The process that runs the handlers of `Situ.Pipeline.on/3`, one after another in the order of the events. A slow
  # handler delays only the start (`:run`) and the end (`:completed`), and may call the pipeline. The process sends the
  # server:
  #
  #   {:situ_handled, event, :ok or {:error, error}, graph}   the result, and the graph with everything that was added
  alias Situ.{Error, Runtime}
  alias Situ.Graph.Builder
  require Logger

  @doc "Returns whether a graph has handlers for `event`."
  @spec any?(Situ.Graph.t(), atom()) :: boolean()
  def any?(graph, event), do: Enum.any?(graph.handlers, &(elem(&1, 0) == event))

  @doc "Calls the handlers of an event; starts their process if it is not running."
  @spec call_handlers(pid() | nil, {atom(), term()}, Situ.Graph.t(), Situ.Graph.Handle.t()) ::
          pid()
  def call_handlers(nil, job, graph, handle) do
    server = self()
    process = Runtime.spawn_process(:proc_lib, "handlers", {__MODULE__, :loop, [server]}, [:link])
    call_handlers(process, job, graph, handle)
  end

  def call_handlers(pid, job, graph, handle) do
    send(pid, {:situ_handle, job, graph, handle})
    pid
  end

  @spec stop_process(pid() | nil) :: term()
  def stop_process(nil), do: :ok
  def stop_process(pid), do: send(pid, :situ_quit)

  @doc false
  def loop(server) do
    # A handler that calls stop/2 must not wait for the stop: the pipeline waits for the handler.
    Process.put(:situ_pipeline, server)
    Process.monitor(server)
    receive_jobs(server)
  end

  defp receive_jobs(server) do
    receive do
      {:situ_handle, {event, argument}, graph, handle} ->
        {result, graph} = run_handlers(handle, graph, event, argument)
        send(server, {:situ_handled, event, result, graph})
        receive_jobs(server)

      :situ_quit ->
        :ok

      {:DOWN, _, :process, ^server, _} ->
        :ok

      _other ->
        receive_jobs(server)
    end
  end

  # A handler that raises is an error of the pipeline. A handler may add handlers for the same event, which run, too.
  defp run_handlers(handle, graph, event, argument) do
    Builder.with_graph(handle, graph, fn -> run_each(handle, event, argument, 0) end)
  end

  defp run_each(handle, event, argument, done) do
    case Enum.drop(Builder.current_graph(handle).handlers, done) do
      [] ->
        :ok

      fresh ->
        for {^event, fun} <- fresh, do: fun.(argument)
        run_each(handle, event, argument, done + length(fresh))
    end
  catch
    kind, reason -> {:error, handler_error(event, kind, reason, __STACKTRACE__)}
  end

  defp handler_error(event, kind, reason, stack) do
    exception = if kind == :error, do: Exception.normalize(:error, reason, stack)

    Error.new(
      :handler_failed,
      "the #{inspect(event)} handler failed: #{Exception.format_banner(kind, reason, stack)}",
      meta: %{
        kind: kind,
        exception: exception,
        reason: exception || reason,
        stacktrace: stack
      }
    )
  end

  @doc "Replaces the handlers with the handlers of a new version, if both versions handle the same events."
  @spec replace_handlers(Situ.Graph.t(), Situ.Graph.t()) :: Situ.Graph.t()
  def replace_handlers(%{handlers: old} = graph, %{handlers: new}) do
    if Enum.map(old, &elem(&1, 0)) == Enum.map(new, &elem(&1, 0)),
      do: %{graph | handlers: new},
      else: graph
  end

  @doc "Calls the `:abandoned` handlers of a pipeline that will not run, so that they can close their resources."
  @spec run_abandoned(Situ.Graph.Handle.t(), Error.t() | nil) :: :ok
  def run_abandoned(handle, error) do
    graph = Builder.close_graph(handle)
    for {:abandoned, fun} <- (graph && graph.handlers) || [], do: fun.(error)
    :ok
  catch
    # The caller may be gone or already has an error, so this error can only be logged.
    kind, reason -> Logger.error(Exception.format(kind, reason, __STACKTRACE__))
  end
end

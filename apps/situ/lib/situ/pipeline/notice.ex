defmodule Situ.Pipeline.Notice do
  @moduledoc false
  # What others are told: the log, telemetry, the handlers of `Situ.Pipeline.on/3`.
  alias Situ.{Error, Telemetry}
  alias Situ.Graph.Builder
  alias Situ.Pipeline.Life
  require Logger

  @doc "An error that ends the pipeline: logged, told, kept."
  @spec failed(Life.t(), Error.t()) :: Life.t()
  def failed(state, error) do
    Logger.error(Exception.message(error))
    state = noted(state, error)
    %{state | errors: state.errors ++ [error]}
  end

  @doc "An error that is told only."
  @spec noted(Life.t(), Error.t()) :: Life.t()
  def noted(state, error) do
    Telemetry.execute(
      [:situ, :component, :error],
      %{originating_time: error.meta[:originating_time]},
      %{
        pipeline: state.settings.name,
        component: error.meta[:component],
        error: error
      }
    )

    {_, state} = notify(state, :error, error)
    state
  end

  # Handlers run here; one that raises is an error of the pipeline. A handler may add others of its kind: they run too.
  @spec notify(Life.t(), atom(), term()) :: {:ok, Life.t()} | {:error, Error.t()}
  def notify(state, event, argument) do
    {:ok, call_handlers(state, event, argument, 0)}
  catch
    kind, reason ->
      banner = Exception.format_banner(kind, reason, __STACKTRACE__)
      exception = if kind == :error, do: Exception.normalize(:error, reason, __STACKTRACE__)

      error =
        Error.new(:handler_failed, "the #{inspect(event)} handler failed: #{banner}",
          meta: %{
            kind: kind,
            exception: exception,
            reason: exception || reason,
            stacktrace: __STACKTRACE__
          }
        )

      if event == :run,
        do: {:error, error},
        else: {:ok, %{state | errors: state.errors ++ [error]}}
  end

  @doc "A pipeline that will not run: what was opened for it can be closed."
  @spec abandoned(Situ.Pipeline.t(), Error.t() | nil) :: :ok
  def abandoned(handle, error) do
    graph = Builder.close(handle)
    for {:abandoned, fun} <- (graph && graph.handlers) || [], do: fun.(error)
    :ok
  catch
    # There is an error already, or nobody to be told of one.
    kind, reason -> Logger.error(Exception.format(kind, reason, __STACKTRACE__))
  end

  defp call_handlers(%{graph: %{handlers: handlers}} = state, event, argument, done) do
    case Enum.drop(handlers, done) do
      [] ->
        state

      fresh ->
        {_, handlers} =
          Builder.lend(state.handle, state.graph, fn ->
            for({^event, fun} <- fresh, do: fun.(argument))
          end)

        state = %{state | graph: %{state.graph | handlers: handlers}}
        call_handlers(state, event, argument, done + length(fresh))
    end
  end
end

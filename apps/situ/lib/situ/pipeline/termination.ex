defmodule Situ.Pipeline.Termination do
  @moduledoc false
  # Ends the process of a pipeline: publishes the result, replies to the callers that are waiting, and chooses the exit
  # reason. The functions return values for the callbacks of `Situ.Pipeline.Server`.
  alias Situ.Application.{Directory, PipelineResults}
  alias Situ.Lifecycle.{Errors, Operations}
  alias Situ.Pipeline.{Dynamic, Handlers, State}

  @type stop :: {:stop, term(), State.t()}

  @doc "Ends the pipeline immediately with the error."
  @spec crash_pipeline(Situ.Error.t(), State.t()) :: stop()
  def crash_pipeline(error, state) do
    life = %{state.life | phase: :completed, step: :over}
    finish_pipeline({:error, %{error | meta: %{errors: [error]}}}, %{state | life: life})
  end

  @doc "Ends the pipeline if it has an outcome."
  @spec stop_if_finished(State.t()) :: {:noreply, State.t()} | stop()
  def stop_if_finished(%{view: %{outcome: nil}} = state), do: {:noreply, state}
  def stop_if_finished(state), do: finish_pipeline(state.view.outcome, state)

  @doc "Publishes the outcome of a pipeline that its supervisor shuts down. The supervisor ends the process."
  @spec publish_outcome(State.t()) :: :ok
  def publish_outcome(%{view: %{outcome: result}} = state) do
    Directory.unregister_pipeline(state.settings)
    PipelineResults.put_result(self(), result)
    Enum.each(state.waiters, &GenServer.reply(&1, result))
  end

  defp finish_pipeline(result, state) do
    Directory.unregister_pipeline(state.settings)
    publish_result(state.settings, result)
    Enum.each(state.waiters, &GenServer.reply(&1, result))
    Enum.each(state.life.operations.open, &reply_to_caller/1)
    Handlers.stop_process(state.handlers)
    life = %{state.life | parts: %{}, operations: %Operations{}}
    state = %{state | waiters: [], dynamic: %Dynamic{}, life: life}

    case {result, state.settings.mode} do
      {{:error, %{code: :abandoned}}, _} -> {:stop, {:shutdown, :abandoned}, state}
      {{:error, error}, :linked} -> exit_abnormally(error)
      {{:error, %{code: :crashed}}, _} -> {:stop, {:shutdown, :crashed}, state}
      _ -> {:stop, :normal, state}
    end
  end

  defp reply_to_caller({_id, %{from: nil}}), do: :ok

  # The part has ended with the pipeline.
  defp reply_to_caller({_id, %{what: {kind, _}, from: from}}) when kind in [:stop_part, :remove],
    do: GenServer.reply(from, :ok)

  defp reply_to_caller({_id, %{from: from}}),
    do: GenServer.reply(from, {:error, Errors.not_running()})

  # Only a linked pipeline exits abnormally, so that its supervisor restarts it. `run/2` and
  # `start/2` return the error instead, and a late `await/2` finds it among the kept results. The
  # exit uses a signal, because the error is already in the log and a second report would repeat
  # it.
  defp exit_abnormally(error) do
    Process.flag(:trap_exit, false)
    Process.exit(self(), {:pipeline_failed, error.code, error.what})
  end

  defp publish_result(%{mode: :run, reply: {caller, reply}}, result),
    do: send(caller, {reply, result})

  defp publish_result(_settings, result), do: PipelineResults.put_result(self(), result)
end

defmodule Situ.Stage.ErrorPolicy do
  @moduledoc false
  # Applies an error to a step as `on_error` specifies: lose a message, restart, or fail.
  alias Situ.Error
  alias Situ.Clock.Timers
  alias Situ.Component.Callback
  alias Situ.Ports.{ErrorCounters, Outputs}
  alias Situ.Stage.{SourceState, Step}

  @doc "Drops the message at which the operator or component at `index` of the stage failed."
  @spec skip_message(Step.t(), Error.t(), non_neg_integer()) :: Step.t()
  def skip_message(step, error, index) do
    ErrorCounters.count_skip(step.host.errors, index)
    Step.report_event(step, {:skipped, error})
    step
  end

  @doc """
  Reports that the operator or component at `index` restarts with a fresh state; the message is lost. The server counts
  the restarts.
  """
  @spec record_restart(Step.t(), Error.t(), non_neg_integer()) :: Step.t()
  def record_restart(step, error, index) do
    ErrorCounters.count_restart(step.host.errors, index)
    Step.report_event(step, {:restarted, error})
    step
  end

  @doc "Applies `on_error` to a failure that the component reports about an earlier message; it keeps its state."
  @spec report_failure(Step.t(), Error.t()) :: Step.t()
  def report_failure(%{worker: worker} = step, error) do
    error = Callback.add_component_path(error, worker.path)

    case worker.on_error do
      :stop -> fail_step(step, error)
      :skip -> skip_message(step, error, step.index)
      :restart -> record_restart(step, error, step.index)
    end
  end

  @doc "Fails the step, and with it the stage: from now on it discards all messages."
  @spec fail_step(Step.t(), Error.t()) :: Step.t()
  def fail_step(%{phase: :failed} = step, _error), do: step

  def fail_step(step, error) do
    ErrorCounters.count_failure(step.host.errors, 0)
    Step.report_event(step, {:failed, error, reached_time(step, error)})
    abandon_step(step, error)
  end

  @doc "Ends a step because another step of its stage has failed."
  @spec abandon_step(Step.t(), Error.t()) :: Step.t()
  def abandon_step(%{phase: :failed} = step, _error), do: step

  def abandon_step(step, error) do
    work = %{step.work | failure: error}
    step = %{step | phase: :failed, timers: Timers.clear(step.timers), work: work}
    step = abandon_consumers(step, error)

    if step.source.stopping in [nil, :done], do: step, else: report_source_stopped(step)
  end

  # Up to where its streams are complete: before the message at which it failed or, without one, up to its last post on
  # the output with the earliest last post. All streams of a source that has reported its end are complete.
  defp reached_time(%{source: %{completed: true, completing: nil}}, _error), do: nil

  defp reached_time(_step, %{meta: %{originating_time: time}}) when is_integer(time), do: time - 1

  defp reached_time(step, _error) do
    times = for %{last_time: time} <- Outputs.list_all(step.outputs), time != nil, do: time
    Enum.min(times, fn -> nil end)
  end

  @doc "Ends external consumers with the error."
  @spec abandon_consumers(Step.t(), Error.t()) :: Step.t()
  def abandon_consumers(step, error),
    do: %{step | outputs: Outputs.abandon_external(step.outputs, error, step.context.now)}

  @doc "Handles a source that has posted its last message; the pipeline is notified once no message is held back."
  @spec report_source_stopped(Step.t()) :: Step.t()
  def report_source_stopped(step) do
    held? = step.phase != :failed and Outputs.any_held?(step.outputs)
    {how, source} = SourceState.mark_stopped(step.source, held?)
    if how == :tell, do: Step.report_event(step, :source_stopped)
    %{step | source: source}
  end
end

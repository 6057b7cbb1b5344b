defmodule Situ.Stage.ErrorPolicy do
  @moduledoc false
  # Applies an error to a stage as its component's `on_error` specifies: lose a message, restart, or fail.
  alias Situ.Error
  alias Situ.Clock.Timers
  alias Situ.Ports.{Outputs, ErrorCounters}
  alias Situ.Stage.{SourceState, State}

  @doc "Decides how to handle an error. While the pipeline is starting, every error ends it."
  @spec decide(State.t()) :: :skip | :restart | :fail
  def decide(%{phase: :starting}), do: :fail
  def decide(%{callback: %{on_error: :stop}}), do: :fail
  def decide(%{callback: %{on_error: on_error}}), do: on_error

  @doc "Drops the message at which the operator or component at `index` failed."
  @spec skip_message(State.t(), Error.t(), non_neg_integer()) :: State.t()
  def skip_message(state, error, index \\ 0) do
    ErrorCounters.count_skip(state.tally, index)
    State.report_event(state, {:skipped, error})
    state
  end

  @doc """
  Reports that the operator or component at `index` restarts with a fresh state; the message is lost. The server counts
  the restarts.
  """
  @spec record_restart(State.t(), Error.t(), non_neg_integer()) :: State.t()
  def record_restart(state, error, index \\ 0) do
    ErrorCounters.count_restart(state.tally, index)
    State.report_event(state, {:restarted, error})
    state
  end

  @doc "Fails the stage: from now on it discards all messages."
  @spec fail_stage(State.t(), Error.t()) :: State.t()
  def fail_stage(%{phase: :failed} = state, _error), do: state

  def fail_stage(state, error) do
    ErrorCounters.count_failure(state.tally, 0)
    State.report_event(state, {:failed, error, reached(state, error)})

    state =
      abandon_consumers(%{state | phase: :failed, timers: Timers.clear(state.timers)}, error)

    if state.source.stopping in [nil, :done], do: state, else: report_source_stopped(state)
  end

  # Up to where its streams are whole: in front of the message it failed at, or, where there was none, up to what it
  # has posted.
  defp reached(_state, %{meta: %{originating_time: time}}) when is_integer(time), do: time - 1

  defp reached(state, _error) do
    times = for %{last_time: time} <- Outputs.list_all(state.outputs), time != nil, do: time
    Enum.min(times, fn -> nil end)
  end

  @doc "Ends external consumers with the error."
  @spec abandon_consumers(State.t(), Error.t()) :: State.t()
  def abandon_consumers(state, error),
    do: %{state | outputs: Outputs.abandon_external(state.outputs, error)}

  @doc "Handles a source that has posted its last message; the pipeline is notified once no message is held back."
  @spec report_source_stopped(State.t()) :: State.t()
  def report_source_stopped(state) do
    held? = state.phase != :failed and Outputs.any_held?(state.outputs)
    {how, source} = SourceState.mark_stopped(state.source, held?)
    if how == :tell, do: State.report_event(state, :source_stopped)
    %{state | source: source}
  end
end

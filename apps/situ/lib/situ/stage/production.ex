defmodule Situ.Stage.Production do
  @moduledoc false
  # Makes a source produce messages while there is demand, and stops it on request.
  alias Situ.Error
  alias Situ.Clock.Timers
  alias Situ.Ports.{ErrorCounters, Output, Outputs}
  alias Situ.Stage.{ActionRunner, CallbackRunner, ErrorPolicy, SourceState, Step}

  @most 4_096
  # Not beyond the clock if it is enforced, because messages ahead of it have to be held.
  @most_ahead 8

  @doc "Asks a pull source for up to `room` messages; returns whether it may have more."
  @spec produce_messages(Step.t(), integer() | :infinity) :: {:idle | :yield, Step.t()}
  def produce_messages(step, room) do
    if SourceState.can_produce?(step.source) and not Outputs.any_held?(step.outputs) do
      most = if step.context.enforced?, do: @most_ahead, else: @most
      step |> ask_source(min(room, most)) |> judge_progress()
    else
      {:idle, step}
    end
  end

  defp ask_source(%{outputs: outputs} = step, room) do
    before = {Outputs.progress_mark(outputs), Outputs.repeated_count(outputs), count_errors(step)}
    count = Outputs.posted_count(outputs)
    started = Step.monotonic_time(step)
    step = CallbackRunner.call_callback(step, :handle_demand, [room])
    posted = Outputs.posted_count(step.outputs) - count
    step |> Step.count_produced(posted, started) |> judge_reply(before)
  end

  defp judge_progress(%{source: source, phase: phase} = step) do
    if source.idle or source.completed or phase == :failed,
      do: {:idle, step},
      else: {:yield, step}
  end

  defp judge_reply(%{phase: :failed} = step, _before), do: step

  defp judge_reply(step, {progress, repeated, errors}) do
    emitted? = Outputs.progress_mark(step.outputs) != progress
    failed? = count_errors(step) != errors
    repeated? = Outputs.repeated_count(step.outputs) != repeated
    # The server limits the number of restarts.
    restarted? = failed? and step.worker.on_error == :restart
    {failed?, repeated?} = {failed? and not restarted?, repeated? or restarted?}

    case SourceState.judge_reply(step.source, emitted?, failed?, repeated?) do
      {:ok, source} -> %{step | source: source}
      {:no_way_on, _source} -> ErrorPolicy.fail_step(step, no_way_on(step))
    end
  end

  defp count_errors(step), do: ErrorCounters.read_counts(step.host.errors, step.index).errors

  defp no_way_on(step) do
    path = step.worker.path

    Error.new(
      :no_way_on,
      "#{path} failed #{SourceState.max_strikes()} times without emitting anything",
      why: "a source that raises has no message to skip, so it would raise again and again",
      fix: "handle the error in handle_demand/3, or use on_error: :stop",
      meta: %{component: path}
    )
  end

  @doc "Stops the source; it sends nothing later than `final`. Light operators have nothing to stop."
  @spec stop_source(Step.t(), Situ.Time.t()) :: Step.t()
  def stop_source(%{source: %{stopping: nil}} = step, final) do
    step = %{
      release_outputs(step, final)
      | source: SourceState.request_stop(step.source, final),
        timers: Timers.drop_after(step.timers, final)
    }

    step =
      if step.phase == :failed or Step.head_vertex(step).module == :operator,
        do: step,
        else: CallbackRunner.call_callback(step, :handle_stop, [final])

    if step.source.stopping == :asked,
      do: ErrorPolicy.report_source_stopped(step),
      else: Step.wake_source(step)
  end

  def stop_source(step, _final), do: step

  @doc "Stops the source immediately; messages that it holds back are lost."
  @spec stop_now(Step.t()) :: Step.t()
  def stop_now(%{source: %{stopping: :done}} = step), do: step
  def stop_now(step), do: step |> release_outputs(:none) |> ErrorPolicy.report_source_stopped()

  defp release_outputs(step, final) do
    step = %{step | outputs: Outputs.set_withheld(step.outputs, false)}
    Step.map_outputs(step, &Output.drop_held_after(&1, final))
  end

  @doc "Reports a completion or stop that was waiting until no message is held back."
  @spec report_released(Step.t()) :: Step.t()
  def report_released(%{source: %{completing: nil, stopping: stopping}} = step)
      when stopping != :held,
      do: step

  def report_released(step) do
    if Outputs.any_held?(step.outputs) do
      step
    else
      time = step.source.completing
      step = if time, do: ActionRunner.announce_end(step, time), else: step
      if step.source.stopping == :held, do: ErrorPolicy.report_source_stopped(step), else: step
    end
  end
end

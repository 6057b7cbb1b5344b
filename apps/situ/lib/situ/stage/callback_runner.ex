defmodule Situ.Stage.CallbackRunner do
  @moduledoc false
  # Calls a callback of the component of a step and applies its result: actions or an error.
  alias Situ.Error
  alias Situ.Clock.Timers
  alias Situ.Component.Callback
  alias Situ.Ports.{Inputs, Output}
  alias Situ.Stage.{ActionRunner, ErrorPolicy, Step}

  @doc "Calls a callback now; the context is added as the argument before the state."
  @spec call_callback(Step.t(), atom(), [term()]) :: Step.t()
  def call_callback(step, callback, args) do
    step = Step.read_clock(step)

    case Callback.call_callback(step.worker, callback, args ++ [step.context]) do
      {:ok, actions, core} -> apply_result(step, core, actions)
      {:error, error} -> handle_error(step, error)
    end
  end

  @doc "Handles a call or cast from another process; an unknown call gets an error reply, an unknown cast is ignored."
  @spec handle_request(Step.t(), term(), GenServer.from() | nil) :: Step.t()
  def handle_request(%{phase: :running, worker: %Callback{} = worker} = step, request, from) do
    if function_exported?(worker.module, :handle_request, 4),
      do: call_callback(step, :handle_request, [request, from]),
      else: refuse_request(step, request, from)
  end

  def handle_request(step, request, from), do: refuse_request(step, request, from)

  defp refuse_request(step, _request, nil), do: step

  defp refuse_request(step, request, from) do
    path = Step.head_vertex(step).path
    what = "#{path} does not answer #{inspect(request, limit: 8, printable_limit: 80)}"
    fix = "define handle_request/4 in the component"
    GenServer.reply(from, {:error, Error.new(:unknown_request, what, fix: fix)})
    step
  end

  @doc "Applies the component's new state and actions; an invalid action reverts the new state, too."
  @spec apply_result(Step.t(), term(), [Situ.Component.action()]) :: Step.t()
  def apply_result(step, core, actions) do
    case try_result(step, core, actions) do
      {:ok, step} -> step
      {:error, error} -> handle_error(step, error)
    end
  end

  @doc "Applies the component's new state and actions, or returns the error of an invalid action."
  @spec try_result(Step.t(), term(), [Situ.Component.action()]) ::
          {:ok, Step.t()} | {:error, Error.t()}
  def try_result(%{worker: worker} = step, core, actions),
    do: ActionRunner.apply_actions(%{step | worker: %{worker | core: core}}, actions)

  @doc "Handles an error according to the component's `on_error`. While the pipeline is starting, every error ends it."
  @spec handle_error(Step.t(), Error.t()) :: Step.t()
  def handle_error(%{phase: :starting} = step, error), do: ErrorPolicy.fail_step(step, error)

  def handle_error(%{worker: %{on_error: on_error}} = step, error) do
    case on_error do
      :stop -> ErrorPolicy.fail_step(step, error)
      :skip -> ErrorPolicy.skip_message(step, error, step.index)
      :restart -> restart_component(step, error)
    end
  end

  defp restart_component(step, error) do
    step = ErrorPolicy.record_restart(step, error, step.index)
    Callback.stop_component(step.worker, error)
    step = Step.map_outputs(step, &Output.resume_after_restart/1)
    step = %{step | inputs: Inputs.forget_progress(step.inputs)}

    with {:ok, worker} <- Callback.start_component(step.worker),
         work = %{step.work | continue: :none, lingers: false},
         step = %{step | worker: worker, work: work, timers: Timers.clear(step.timers)},
         step = Step.read_clock(step),
         {:ok, actions, core} <- Callback.call_callback(worker, :handle_start, [step.context]),
         {:ok, step} <- try_result(step, core, actions) do
      step
    else
      {:error, error} -> ErrorPolicy.fail_step(step, error)
    end
  end
end

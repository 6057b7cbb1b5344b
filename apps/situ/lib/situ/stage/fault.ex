defmodule Situ.Stage.Fault do
  @moduledoc false
  # What an error does to a stage: the end, a message lost, or a fresh start.
  alias Situ.{Clock, Error, Stage}
  alias Situ.Stage.{Actions, Call, Outlet, Ports, Source, Tally}

  @doc "As the component's `on_error` says."
  @spec wrong(Stage.t(), Error.t()) :: Stage.t()
  def wrong(%{phase: :starting} = state, error), do: fail(state, error)

  def wrong(state, error) do
    case state.head.on_error do
      :stop -> fail(state, error)
      :skip -> skip(state, error)
      :restart -> restart(state, error)
    end
  end

  defp skip(state, error) do
    Tally.skipped(state.tally, 0)
    Stage.report(state, {:skipped, error})
    state
  end

  defp restart(state, error) do
    Tally.restarted(state.tally, 0)
    Stage.report(state, {:skipped, error})
    Call.terminate(state.module, error, state.core, state.head.path)
    state = Ports.each_outlet(state, &Outlet.resume/1)

    case Call.init(state.module, state.opts, state.head.path) do
      {:ok, core} ->
        state = %{state | core: core, timers: []}

        case Call.run(state.module, :handle_start, [state.context, core], state.head.path) do
          {:ok, actions, core} -> restarted(%{state | core: core}, actions)
          {:error, error} -> fail(state, error)
        end

      {:error, error} ->
        fail(state, error)
    end
  end

  defp restarted(state, actions) do
    case Actions.run(state, actions, Clock.now(state.clock)) do
      {:ok, state} -> state
      {:error, error} -> fail(state, error)
    end
  end

  @doc "Nothing more is taken; what comes is thrown away."
  @spec fail(Stage.t(), Error.t()) :: Stage.t()
  def fail(%{failed: true} = state, _error), do: state

  def fail(state, error) do
    Tally.failed(state.tally, 0)
    Stage.report(state, {:failed, error})
    state = %{state | failed: true, timers: []}
    if state.stopping in [nil, :done], do: state, else: Source.stopped(state)
  end
end

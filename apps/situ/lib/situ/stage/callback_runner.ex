defmodule Situ.Stage.CallbackRunner do
  @moduledoc false
  # Calls a callback of the component and applies its result: actions or an error.
  alias Situ.{Clock, Error}
  alias Situ.Clock.Timers
  alias Situ.Component.Callback
  alias Situ.Ports.{Output, Outputs}
  alias Situ.Stage.{ActionRunner, ErrorPolicy, State}

  @doc "Calls a callback at clock time `now`; the context is added as the argument before the state."
  @spec call_callback(State.t(), atom(), [term()], Situ.Time.t()) :: State.t()
  def call_callback(state, callback, args, now) do
    case Callback.call_callback(state.callback, callback, args ++ [State.context_at(state, now)]) do
      {:ok, actions, core} -> apply_result(state, core, actions, now)
      {:error, error} -> handle_error(state, error)
    end
  end

  @doc "Handles a call or cast from another process; an unknown call gets an error reply, an unknown cast is ignored."
  @spec handle_request(State.t(), term(), GenServer.from() | nil) :: State.t()
  def handle_request(%{phase: :running, callback: %Callback{}} = state, request, from) do
    if function_exported?(state.callback.module, :handle_request, 4),
      do: call_callback(state, :handle_request, [request, from], Clock.now(state.clock)),
      else: unknown(state, request, from)
  end

  def handle_request(state, request, from), do: unknown(state, request, from)

  defp unknown(state, _request, nil), do: state

  defp unknown(state, request, from) do
    path = State.head_vertex(state).path
    what = "#{path} does not answer #{inspect(request, limit: 8, printable_limit: 80)}"
    fix = "define handle_request/4 in the component"
    GenServer.reply(from, {:error, Error.new(:unknown_request, what, fix: fix)})
    state
  end

  @doc "Applies the component's new state and actions; an invalid action reverts the new state, too."
  @spec apply_result(State.t(), term(), [Situ.Component.action()], Situ.Time.t()) :: State.t()
  def apply_result(state, core, actions, now) do
    case ActionRunner.apply_actions(
           %{state | callback: %{state.callback | core: core}},
           actions,
           now
         ) do
      {:ok, state} -> state
      {:error, error} -> handle_error(state, error)
    end
  end

  @doc "Handles an error according to the component's `on_error`."
  @spec handle_error(State.t(), Error.t()) :: State.t()
  def handle_error(state, error) do
    case ErrorPolicy.decide(state) do
      :fail -> ErrorPolicy.fail_stage(state, error)
      :skip -> ErrorPolicy.skip_message(state, error)
      :restart -> restart(state, error)
    end
  end

  defp restart(state, error) do
    state = ErrorPolicy.record_restart(state, error)
    Callback.stop_component(state.callback, error)
    state = %{state | outputs: Outputs.map_outputs(state.outputs, &Output.resume_after_restart/1)}
    context = State.context_at(state, Clock.now(state.clock))

    with {:ok, callback} <- Callback.start_component(state.callback),
         state = %{state | callback: callback, timers: Timers.clear(state.timers)},
         state = %{state | pace: %{state.pace | continue: :none, lingers: false}},
         {:ok, actions, core} <- Callback.call_callback(callback, :handle_start, [context]),
         state = %{state | callback: %{callback | core: core}},
         {:ok, state} <- ActionRunner.apply_actions(state, actions, Clock.now(state.clock)) do
      state
    else
      {:error, error} -> ErrorPolicy.fail_stage(state, error)
    end
  end
end

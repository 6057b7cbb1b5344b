defmodule Situ.Stage.Activation do
  @moduledoc false
  # Calls a callback of the component and applies its result: actions or an error.
  alias Situ.{Clock, Error}
  alias Situ.Clock.Timers
  alias Situ.Component.Callback
  alias Situ.Ports.{Output, Outputs}
  alias Situ.Stage.{Emission, ErrorPolicy, State}

  @doc "Calls a callback at clock time `now`; the context is added as the argument before the state."
  @spec call(State.t(), atom(), [term()], Situ.Time.t()) :: State.t()
  def call(state, callback, args, now) do
    case Callback.call(state.callback, callback, args ++ [State.context(state, now)]) do
      {:ok, actions, core} -> act(state, core, actions, now)
      {:error, error} -> wrong(state, error)
    end
  end

  @doc "Handles a call or cast from another process; an unknown call gets an error reply, an unknown cast is ignored."
  @spec request(State.t(), term(), GenServer.from() | nil) :: State.t()
  def request(%{phase: :running, callback: %Callback{}} = state, request, from) do
    if function_exported?(state.callback.module, :handle_request, 4),
      do: call(state, :handle_request, [request, from], Clock.now(state.clock)),
      else: unknown(state, request, from)
  end

  def request(state, request, from), do: unknown(state, request, from)

  defp unknown(state, _request, nil), do: state

  defp unknown(state, request, from) do
    path = State.head(state).path
    what = "#{path} does not answer #{inspect(request, limit: 8, printable_limit: 80)}"
    fix = "define handle_request/4 in the component"
    GenServer.reply(from, {:error, Error.new(:unknown_request, what, fix: fix)})
    state
  end

  @doc "Applies the component's new state and actions; an invalid action reverts the new state, too."
  @spec act(State.t(), term(), [Situ.Component.action()], Situ.Time.t()) :: State.t()
  def act(state, core, actions, now) do
    case Emission.run(%{state | callback: %{state.callback | core: core}}, actions, now) do
      {:ok, state} -> state
      {:error, error} -> wrong(state, error)
    end
  end

  @doc "Handles an error according to the component's `on_error`."
  @spec wrong(State.t(), Error.t()) :: State.t()
  def wrong(state, error) do
    case ErrorPolicy.decide(state) do
      :fail -> ErrorPolicy.fail(state, error)
      :skip -> ErrorPolicy.skip(state, error)
      :restart -> restart(state, error)
    end
  end

  defp restart(state, error) do
    state = ErrorPolicy.restarted(state, error)
    Callback.stop(state.callback, error)
    state = %{state | outputs: Outputs.each(state.outputs, &Output.resume/1)}
    context = State.context(state, Clock.now(state.clock))

    with {:ok, callback} <- Callback.start(state.callback),
         state = %{state | callback: callback, timers: Timers.clear(state.timers)},
         state = %{state | pace: %{state.pace | continue: :none, lingers: false}},
         {:ok, actions, core} <- Callback.call(callback, :handle_start, [context]),
         state = %{state | callback: %{callback | core: core}},
         {:ok, state} <- Emission.run(state, actions, Clock.now(state.clock)) do
      state
    else
      {:error, error} -> ErrorPolicy.fail(state, error)
    end
  end
end

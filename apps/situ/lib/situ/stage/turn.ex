defmodule Situ.Stage.Turn do
  @moduledoc false
  # A call into the component, and what it answered: its actions, or an error.
  alias Situ.{Clock, Stage}
  alias Situ.Stage.{Actions, Alarm, Call, Fault, Ports, Pump}

  @spec call(Stage.t(), atom(), [term()], Situ.Time.t() | nil) :: Stage.t()
  def call(state, callback, args, now) do
    case Call.run(state.module, callback, args ++ [state.core], state.head.path) do
      {:ok, actions, core} -> act(state, core, actions, now)
      {:error, error} -> Fault.wrong(state, error)
    end
  end

  # An action that is wrong takes the new state back, too.
  @spec act(Stage.t(), term(), [Situ.Component.action()], Situ.Time.t() | nil) :: Stage.t()
  def act(state, core, actions, now) do
    case Actions.run(%{state | core: core}, actions, now || Clock.now(state.clock)) do
      {:ok, state} -> Alarm.arm(Ports.settle(state))
      {:error, error} -> Fault.wrong(state, error)
    end
  end

  # A neighbour that started sooner may have closed already: its word waits until this stage knows its neighbours too.
  @spec other(Stage.t(), term()) :: Stage.t()
  def other(%{clock: nil} = state, message), do: %{state | early: [message | state.early]}

  def other(%{kind: :component, failed: false} = state, message) do
    now = Clock.now(state.clock)

    %{state | idle: false}
    |> call(:handle_info, [message, %{state.context | now: now}], now)
    |> Pump.pump()
  end

  def other(state, _message), do: state
end

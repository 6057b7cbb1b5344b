defmodule Situ.StateMachine.Runner do
  @moduledoc false
  # The component of a state machine. It passes events to the machine in time order.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [fun: [type: {:fun, 3}, required: true], init: [type: {:fun, 0}, required: true]]

  defstruct [:fun, :state, :data, :due]

  @impl true
  def init(opts) do
    {state, data} = opts[:init].()
    {:ok, %__MODULE__{fun: opts[:fun], state: state, data: data}}
  end

  @impl true
  def handle_message(_input, %{originating_time: time} = message, _context, machine) do
    {before, machine} = run_timeouts(machine, time, [])
    {now, machine} = run_event(machine, {:message, message}, time)
    {before ++ now, machine}
  end

  @impl true
  def handle_closed(_input, time, _context, machine) do
    {before, machine} = run_timeouts(machine, time + 1, [])
    {now, machine} = run_event(machine, {:closed, time}, time)
    # An output at the closing time may already exist, from the last message or a timeout.
    {before ++ Enum.map(now, fn {:out, _, data} -> {:out, time + 1, data} end), machine}
  end

  # Runs the timeouts due before `time`; each may request another one.
  defp run_timeouts(%{due: due} = machine, time, outputs) when due != nil and due < time do
    {now, machine} = run_event(%{machine | due: nil}, :state_timeout, due)
    run_timeouts(machine, time, outputs ++ now)
  end

  defp run_timeouts(machine, _time, outputs), do: {outputs, machine}

  defp run_event(machine, event, time) do
    case machine.fun.(machine.state, event, machine.data) do
      {:keep_state, data} ->
        {[], %{machine | data: data}}

      {:keep_state, data, actions} ->
        apply_actions(%{machine | data: data}, actions, time)

      {:next_state, state, data} ->
        apply_actions(change_state(machine, state, data), [], time)

      {:next_state, state, data, actions} ->
        apply_actions(change_state(machine, state, data), actions, time)

      other ->
        raise ArgumentError, "not a valid result of a state machine: #{inspect(other)}"
    end
  end

  defp change_state(machine, state, data), do: %{machine | state: state, data: data, due: nil}

  defp apply_actions(machine, actions, time) do
    machine =
      Enum.reduce(actions, machine, fn
        {:state_timeout, :infinity}, machine -> %{machine | due: nil}
        {:state_timeout, ns}, machine when ns > 0 -> %{machine | due: time + ns}
        {:emit, _}, machine -> machine
      end)

    {for({:emit, data} <- actions, do: {:out, time, data}), machine}
  end

  @impl true
  def describe(%{state: state}), do: "in state #{inspect(state, limit: 8)}"
end

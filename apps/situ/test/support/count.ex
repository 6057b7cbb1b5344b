defmodule Situ.Fixture.Count do
  @moduledoc false
  # A pull source of the integers 0, 1, 2 ..., `interval` ns apart, from the pipeline's start.
  use Situ.Component,
    outputs: [out: :integer],
    options: [
      count: [type: {:or, [:non_neg_integer, {:in, [:infinity]}]}, default: 10],
      interval: [type: :pos_integer, default: 1]
    ]

  @impl true
  def init(opts),
    do:
      {:ok, %{count: opts[:count], interval: opts[:interval], next: 0, time: 0, final: :infinity}}

  @impl true
  def handle_start(context, state) do
    state = %{state | time: context.start_time}

    case state.count do
      0 -> {[{:complete, context.start_time}], state}
      :infinity -> {[{:complete, :infinity}], state}
      _ -> {[], state}
    end
  end

  @impl true
  def handle_demand(n, _context, state), do: produce(n, state, [])

  @impl true
  def handle_stop(final, _context, state) do
    if state.next != state.count and state.time <= final,
      do: {[:stopping], %{state | final: final}},
      else: {[], state}
  end

  defp produce(0, state, actions), do: {Enum.reverse(actions), state}

  defp produce(_n, %{count: count, next: count} = state, actions),
    do: {Enum.reverse(actions), state}

  defp produce(_n, %{time: time, final: final} = state, actions) when time > final,
    do: {Enum.reverse([:stopped | actions]), state}

  defp produce(n, state, actions) do
    actions = [{:out, state.time, state.next} | actions]
    last? = state.next + 1 == state.count
    actions = if last?, do: [:stopped, {:complete, state.time} | actions], else: actions
    produce(n - 1, %{state | next: state.next + 1, time: state.time + state.interval}, actions)
  end
end

defmodule Situ.Generator.Timer do
  @moduledoc false
  # The push source of timer. It emits a message each time the clock has advanced by an interval.
  use Situ.Component,
    inputs: [],
    outputs: [out: :any],
    options: [every: [type: :pos_integer, required: true], fun: [type: {:fun, 2}]]

  @impl true
  def init(opts) do
    {:ok, %{every: opts[:every], fun: opts[:fun] || fn _now, elapsed -> elapsed end, last: nil}}
  end

  # A timer never ends by itself; only the end of a replay ends it.
  @impl true
  def handle_start(context, state) do
    ending = if context.replay_end == :infinity, do: [{:complete, :infinity}], else: []
    {ending ++ schedule_tick(context.start_time, context, state), state}
  end

  @impl true
  def handle_info({:timer, {:tick, due}}, context, state) do
    time = if state.last == nil, do: context.now, else: max(context.now, state.last + 1)
    data = state.fun.(time, time - context.start_time)
    # Missed ticks are skipped.
    missed = div(max(context.now - due, 0), state.every) * state.every
    {[{:out, time, data} | schedule_tick(due + missed, context, state)], %{state | last: time}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  defp schedule_tick(after_time, context, state) do
    due = after_time + state.every

    if due > context.replay_end,
      do: [{:complete, context.replay_end}],
      else: [{:timer, {:tick, due}, due}]
  end
end

defmodule Situ.Selection.Reorder do
  @moduledoc false
  # Buffers messages, ordered by a time of each message, for as long as the lateness allows.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [
      lateness: [type: :non_neg_integer, required: true],
      time: [type: {:fun, 1}, required: true],
      late: [type: {:in, [:drop, :error]}, default: :drop]
    ]

  @impl true
  def init(opts),
    do: {:ok, %{opts: Map.new(opts), queue: :gb_trees.empty(), newest: nil, sent: nil}}

  @impl true
  def handle_message(_input, message, _context, state) do
    time = state.opts.time.(message)

    cond do
      state.sent != nil and time <= state.sent -> handle_late(time, state)
      :gb_trees.is_defined(time, state.queue) -> {[], state}
      true -> hold_message(time, message.data, state)
    end
  end

  @impl true
  def handle_closed(_input, _time, _context, state), do: release_before(state, :infinity, [])

  defp hold_message(time, data, state) do
    # `nil` is an atom and would sort after any time.
    newest = if state.newest == nil, do: time, else: max(time, state.newest)
    state = %{state | queue: :gb_trees.insert(time, data, state.queue), newest: newest}
    release_before(state, newest - state.opts.lateness, [])
  end

  # Emits everything before `limit`. A message may still arrive at the limit itself.
  defp release_before(state, limit, outputs) do
    with false <- :gb_trees.is_empty(state.queue),
         {time, data, rest} when time < limit <- :gb_trees.take_smallest(state.queue) do
      release_before(%{state | queue: rest, sent: time}, limit, [{:out, time, data} | outputs])
    else
      _ -> {Enum.reverse(outputs), state}
    end
  end

  defp handle_late(_time, %{opts: %{late: :drop}} = state), do: {[], state}

  defp handle_late(time, state) do
    raise Situ.Error.new(:late, "a message at #{time} ns arrived after one at #{state.sent} ns",
            why: "it is more than #{state.opts.lateness} ns late",
            fix: "increase the lateness, or drop late messages with late: :drop"
          )
  end
end

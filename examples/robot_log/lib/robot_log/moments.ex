defmodule RobotLog.Moments do
  @moduledoc """
  Emits the intervals in which numbers are above a threshold. Intervals that are closer than `join` become one. An
  interval is emitted when its end is certain, at the time of its end.
  """
  use Situ.Component,
    inputs: [in: :number],
    outputs: [out: Situ.Interval],
    options: [
      above: [type: :number, required: true, doc: "The threshold."],
      join: [
        type: :time_ns,
        default: 0,
        doc: "The longest time between two parts of an interval, in ns."
      ]
    ]

  alias Situ.Interval

  @impl true
  def init(opts), do: {:ok, %{above: opts[:above], join: opts[:join], open: nil}}

  @impl true
  def handle_message(:in, %{data: value, originating_time: time}, _context, state) do
    case state.open do
      nil when value > state.above -> {[], %{state | open: {time, time}}}
      {from, _to} when value > state.above -> {[], %{state | open: {from, time}}}
      {_from, to} when time - to > state.join -> {[emit(state.open)], %{state | open: nil}}
      _ -> {[], state}
    end
  end

  # The log may end in the middle of a shock.
  @impl true
  def handle_closed(:in, _time, _context, %{open: nil} = state), do: {[], state}
  def handle_closed(:in, _time, _context, state), do: {[emit(state.open)], %{state | open: nil}}

  defp emit({from, to}), do: {:out, to, Interval.closed(from, to)}
end

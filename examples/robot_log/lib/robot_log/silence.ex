defmodule RobotLog.Silence do
  @moduledoc """
  Emits the intervals in which no message arrived, although the average rate promised one. It needs ten messages before
  it judges.
  """
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: Situ.Interval],
    options: [
      factor: [
        type: :number,
        default: 3.0,
        doc: "How many times the average interval is a silence."
      ]
    ]

  alias Situ.Interval

  @enough 10

  @impl true
  def init(opts), do: {:ok, %{factor: opts[:factor], first: nil, last: nil, count: 0}}

  @impl true
  def handle_message(:in, %{originating_time: time}, _context, state) do
    next = %{state | first: state.first || time, last: time, count: state.count + 1}

    if state.count >= @enough and time - state.last > state.factor * average(state),
      do: {[{:out, time, Interval.closed(state.last, time)}], next},
      else: {[], next}
  end

  defp average(state), do: (state.last - state.first) / (state.count - 1)
end

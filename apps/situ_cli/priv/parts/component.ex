defmodule {{Module}} do
  @moduledoc """
  Emits the numbers that differ from the number before by more than `step`.
  """
  use Situ.Component,
    inputs: [in: :number],
    outputs: [out: :number],
    options: [step: [type: :number, default: 0, doc: "The smallest difference to report."]]

  @impl true
  def init(opts), do: {:ok, %{step: opts[:step], last: nil}}

  @impl true
  def handle_message(:in, %{data: number, originating_time: time}, _context, state) do
    if state.last == nil or abs(number - state.last) > state.step,
      do: {[{:out, time, number}], %{state | last: number}},
      else: {[], state}
  end
end

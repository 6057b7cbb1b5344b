defmodule Situ.Fixture.Feedback do
  @moduledoc false
  # Adds its previous output, received through a cycle, to each number; the cycle keeps its own order.
  use Situ.Component, inputs: [in: :integer, back: :integer], outputs: [out: :integer]

  @impl true
  def init(_opts), do: {:ok, %{waiting: :queue.new(), back: 0}}

  @impl true
  def handle_message(:in, message, _context, %{back: nil} = state),
    do: {[], %{state | waiting: :queue.in(message, state.waiting)}}

  def handle_message(:in, message, _context, state), do: next(message, state)

  def handle_message(:back, %{data: back}, _context, state) do
    case :queue.out(state.waiting) do
      {:empty, _} -> {[], %{state | back: back}}
      {{:value, message}, waiting} -> next(message, %{state | waiting: waiting, back: back})
    end
  end

  defp next(message, state),
    do: {[{:out, message.originating_time, message.data + state.back}], %{state | back: nil}}
end

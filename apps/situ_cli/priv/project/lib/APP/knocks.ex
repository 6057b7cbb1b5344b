defmodule {{Module}}.Knocks do
  @moduledoc """
  Emits the level of every knock: a level at or above `threshold`, after at least `quiet` without a knock.
  """
  use Situ.Component,
    inputs: [in: :number],
    outputs: [out: :number],
    options: [
      threshold: [type: :number, default: 0.6, doc: "The level of a knock, from 0 to 1."],
      quiet: [type: :time_ns, default: 200_000_000, doc: "The time between two knocks, ns."]
    ]

  @impl true
  def init(opts), do: {:ok, %{threshold: opts[:threshold], quiet: opts[:quiet], last: nil}}

  # The state is a plain map, so the component can be tested, checkpointed and moved to another machine.
  @impl true
  def handle_message(:in, %{data: level, originating_time: time}, _context, state) do
    if level >= state.threshold and quiet?(state, time),
      do: {[{:out, time, level}], %{state | last: time}},
      else: {[], state}
  end

  defp quiet?(%{last: nil}, _time), do: true
  defp quiet?(%{last: last, quiet: quiet}, time), do: time - last >= quiet
end

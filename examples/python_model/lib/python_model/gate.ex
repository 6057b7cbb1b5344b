defmodule PythonModel.Gate do
  @moduledoc """
  Emits `true` while numbers are above a threshold and for `hold` after that, and else `false`.
  """
  use Situ.Component,
    inputs: [in: :number],
    outputs: [out: :boolean],
    options: [
      above: [type: :number, required: true, doc: "The threshold."],
      hold: [type: :time_ns, default: 0, doc: "How long it stays open, in ns."]
    ]

  @impl true
  def init(opts), do: {:ok, %{above: opts[:above], hold: opts[:hold], last: nil}}

  @impl true
  def handle_message(:in, %{data: value, originating_time: time}, _context, state) do
    state = if value > state.above, do: %{state | last: time}, else: state
    {[{:out, time, state.last != nil and time - state.last <= state.hold}], state}
  end
end

defmodule Situ.Python.Workers.Splitter do
  @moduledoc false
  # Emits each message at the next of its outputs.
  use Situ.Component,
    inputs: [in: :any],
    options: [outputs_in_turn: [type: :any, required: true]]

  @impl true
  def init(opts), do: {:ok, opts[:outputs_in_turn]}

  @impl true
  def handle_message(_input, message, _context, [output | rest]),
    do: {[{output, message.originating_time, message.data}], rest ++ [output]}
end

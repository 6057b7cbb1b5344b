defmodule Situ.Selection.Process do
  @moduledoc false
  # Runs a user's function that returns any number of messages.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [
      state: [type: :any],
      fun: [type: {:fun, 2}, required: true],
      on_close: [type: {:optional, {:fun, 2}}]
    ]

  @impl true
  def init(opts), do: {:ok, {opts[:fun], opts[:on_close], opts[:state]}}

  @impl true
  def handle_message(_input, message, _context, {fun, on_close, state}) do
    {outputs, state} = fun.(message, state)
    {output_actions(outputs), {fun, on_close, state}}
  end

  @impl true
  def handle_closed(_input, _time, _context, {_fun, nil, _state} = core), do: {[], core}

  def handle_closed(_input, time, _context, {_fun, on_close, state} = core),
    do: {output_actions(on_close.(time, state)), core}

  defp output_actions(outputs), do: Enum.map(outputs, fn {time, data} -> {:out, time, data} end)
end

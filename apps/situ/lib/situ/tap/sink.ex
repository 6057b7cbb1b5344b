defmodule Situ.Tap.Sink do
  @moduledoc false
  # The component that runs the function of a tap, or forwards messages to the node that does.
  use Situ.Component, inputs: [in: :any], options: [fun: [type: {:fun, 1}], to: [type: :any]]
  alias Situ.Tap.LocalRunner

  @impl true
  def init(opts), do: {:ok, if(opts[:to], do: {:to, opts[:to]}, else: opts[:fun])}

  @impl true
  def handle_message(:in, message, _context, {:to, runner} = state) do
    LocalRunner.hand_over(runner, message)
    {[], state}
  end

  def handle_message(:in, message, _context, fun) do
    fun.(message)
    {[], fun}
  end
end

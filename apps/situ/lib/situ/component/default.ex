defmodule Situ.Component.Default do
  @moduledoc false
  # The default implementations of callbacks that a component does not define.

  def init(opts), do: {:ok, opts}
  def handle_start(_context, state), do: {[], state}
  def handle_message(_input, _message, _context, state), do: {[], state}
  def handle_closed(_input, _time, _context, state), do: {[], state}
  def handle_info(_info, _context, state), do: {[], state}
  def handle_stop(_final_time, _context, state), do: {[], state}
  def terminate(_reason, _state), do: :ok
end

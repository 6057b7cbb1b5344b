defmodule Situ.GenStage.Accumulator do
  @moduledoc false
  # Holds messages back until a consumer sets the demand to `:forward`.
  use Situ.Component, inputs: [in: :any], outputs: [out: :any]

  @impl true
  def handle_start(_context, state), do: {[{:demand, :accumulate}], state}

  @impl true
  def handle_message(:in, message, _context, state), do: {[{:out, message}], state}

  @impl true
  def handle_messages(:in, messages, _context, state), do: {[{:out, messages}], state}
end

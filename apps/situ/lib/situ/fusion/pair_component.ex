defmodule Situ.Fusion.PairComponent do
  @moduledoc false
  # The component of pair. It pairs each primary with the secondary that arrived last.
  use Situ.Component,
    share_process: true,
    inputs: [primary: :any, secondary: :any],
    outputs: [out: :any],
    options: [creator: [type: {:fun, 2}, required: true], initial: [type: :any]]

  @impl true
  def init(opts), do: {:ok, {opts[:creator], Keyword.fetch(opts, :initial)}}

  @impl true
  def handle_message(:secondary, message, _context, {creator, _latest}),
    do: {[], {creator, {:ok, message.data}}}

  def handle_message(:primary, _message, _context, {_creator, :error} = state), do: {[], state}

  def handle_message(:primary, message, _context, {creator, {:ok, latest}} = state),
    do: {[{:out, message.originating_time, creator.(message.data, latest)}], state}
end

defmodule Situ.GenStage.Outlet do
  @moduledoc false
  # Passes messages on to GenStage consumers: through a dispatcher, or not before one of them sets the demand to
  # `:forward`.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [
      dispatcher: [type: :any, default: nil],
      demand: [type: {:in, [:accumulate, :forward]}, default: :forward]
    ]

  @impl true
  def init(opts), do: {:ok, opts}

  @impl true
  def handle_start(_context, opts) do
    dispatcher = if opts[:dispatcher], do: [{:dispatcher, opts[:dispatcher]}], else: []
    demand = if opts[:demand] == :accumulate, do: [{:demand, :accumulate}], else: []
    {dispatcher ++ demand, opts}
  end

  @impl true
  def handle_message(:in, message, _context, opts), do: {[{:out, message}], opts}

  @impl true
  def handle_messages(:in, messages, _context, opts), do: {[{:out, messages}], opts}

  # The error of one message, which the dispatcher has dropped.
  @impl true
  def handle_info({:situ_dispatch_failed, error}, _context, _opts), do: raise(error)
  def handle_info(_other, _context, opts), do: {[], opts}
end

defmodule Situ.Cluster.OutletComponent do
  @moduledoc false
  # Ends a stream that leaves its part: passes all messages to the part's publisher, and waits while the
  # publisher is full.
  use Situ.Component,
    inputs: [in: :any],
    options: [
      publisher: [type: :pid, required: true],
      stream: [type: :string, required: true]
    ]

  alias Situ.Cluster.Publisher

  @impl true
  def init(opts), do: {:ok, %{publisher: opts[:publisher], stream: opts[:stream]}}

  @impl true
  def handle_message(:in, message, context, state),
    do: handle_messages(:in, [message], context, state)

  @impl true
  def handle_messages(:in, messages, _context, state) do
    :ok = Publisher.publish_messages(state.publisher, state.stream, messages)
    {[], state}
  end

  @impl true
  def handle_closed(:in, time, _context, state) do
    :ok = Publisher.close_stream(state.publisher, state.stream, time)
    {[], state}
  end

  @impl true
  def snapshot(_state), do: {:ok, nil}
  @impl true
  def restore(nil, fresh), do: {:ok, fresh}
end

defmodule Situ.Bridge.Recorder.Sink do
  @moduledoc false
  # Writes one stream to the file.
  use Situ.Component,
    inputs: [in: :any],
    options: [
      server: [type: :pid, required: true],
      topic: [type: :string, required: true],
      topic_options: [type: :keyword, default: []]
    ]

  alias Situ.Bridge.Recorder.Server

  @impl true
  def init(opts), do: {:ok, Map.put(Map.new(opts), :open, true)}

  @impl true
  def handle_start(_context, state) do
    Situ.Error.unwrap!(Server.open_file(state.server))
    {[], state}
  end

  @impl true
  def handle_message(input, message, context, state),
    do: handle_messages(input, [message], context, state)

  @impl true
  def handle_messages(:in, messages, _context, state) do
    Situ.Error.unwrap!(
      Server.write_messages(state.server, state.topic, messages, state.topic_options)
    )

    {[], state}
  end

  @impl true
  def handle_closed(:in, _time, _context, state) do
    Situ.Error.unwrap!(Server.finish_stream(state.server))
    {[], %{state | open: false}}
  end

  @impl true
  def terminate(_reason, %{open: false}), do: :ok
  def terminate(_reason, state), do: Server.finish_stream(state.server)
end

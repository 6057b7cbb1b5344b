defmodule Situ.Link.ConfirmComponent do
  @moduledoc false
  # Confirms messages after they have been processed, so that they are not sent again after a kill.
  # `Situ.Link.confirm/3` adds this component.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [],
    options: [
      link: [type: :pid, required: true, doc: "The `Situ.Link.Connection`."],
      stream: [type: :string, required: true, doc: "The name of the stream on the link."]
    ]

  alias Situ.Link.Connection

  @impl true
  def init(opts), do: {:ok, {opts[:link], opts[:stream]}}

  @impl true
  def handle_message(:in, message, context, state),
    do: handle_messages(:in, [message], context, state)

  @impl true
  def handle_messages(:in, messages, _context, {link, name} = state) do
    Connection.confirm(link, name, List.last(messages).originating_time)
    {[], state}
  end
end

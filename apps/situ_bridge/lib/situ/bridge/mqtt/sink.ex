defmodule Situ.Bridge.Mqtt.Sink do
  alias Situ.Bridge.Mqtt.ClientOptions
  alias Situ.Bridge.Net.ClientSocket
  alias Situ.Bridge.PeerSender

  @schema [
            host: [type: :string, required: true, doc: "The host of the broker."],
            topic: [type: :string, required: true, doc: "The topic to publish to."],
            qos: [
              type: {:in, [0, 1, 2]},
              default: 1,
              doc:
                "2: the broker gets each message exactly once. 1: messages are sent again until the broker " <>
                  "acknowledges them. 0: messages are sent only once."
            ],
            retain: [
              type: :boolean,
              default: false,
              doc: "Asks the broker to keep the last message for clients that subscribe later."
            ],
            content_type: [
              type: {:optional, :string},
              default: nil,
              doc: "The media type of the messages. By default, it follows from the format."
            ],
            user_properties: [
              type: {:list, {:tuple, [:string, :string]}},
              default: [],
              doc: "Names and values that are sent with each message."
            ],
            response_topic: [
              type: {:optional, :string},
              default: nil,
              doc: "The topic for replies to the messages."
            ],
            message_expiry: [
              type: {:optional, {:integer, 1, 4_294_967_295}},
              default: nil,
              doc: "How long the broker keeps a message for absent subscribers, s."
            ]
          ] ++
            ClientOptions.schema() ++
            ClientSocket.tls_options() ++
            Keyword.drop(PeerSender.options(), [:listening, :wait_for])
  @moduledoc false
  # Publishes a stream to a topic. `Situ.Bridge.Mqtt.Message` may name another topic and other properties.
  use Situ.Component, inputs: [in: :any], options: @schema
  use PeerSender
  alias Situ.Bridge.Mqtt.{Message, Publisher}

  @content_types %{
    json: "application/json",
    csv: "text/csv",
    message_pack: "application/msgpack",
    situ: "application/vnd.situ",
    raw: nil
  }

  def schema, do: @schema

  @impl true
  def init(opts), do: {:ok, PeerSender.new([wait_for: 0] ++ opts)}

  @impl true
  def handle_start(_context, %{opts: opts} = sender) do
    opts = [id: ClientOptions.random_id(), port: ClientOptions.port(opts)] ++ opts
    {:ok, publisher} = Publisher.start_link(opts)
    {[], PeerSender.attach_server(sender, Publisher, publisher, nil)}
  end

  @impl true
  def handle_message(:in, message, _context, sender),
    do: PeerSender.send_payload(sender, build_message(message, sender.opts))

  defp build_message(%{data: %Message{} = own} = message, opts) do
    payload = PeerSender.encode_payload(%{message | data: own.payload}, opts)

    %{
      topic: own.topic || opts[:topic],
      payload: payload,
      qos: min(own.qos || opts[:qos], opts[:qos]),
      retain?: own.retain? or opts[:retain],
      properties: build_properties(own, message, opts)
    }
  end

  defp build_message(message, opts),
    do: build_message(%{message | data: %Message{payload: message.data}}, opts)

  defp build_properties(own, message, opts) do
    time =
      if opts[:format] == :raw,
        do: [{Message.time_name(), to_string(message.originating_time)}],
        else: []

    Message.to_properties(%{
      own
      | content_type: own.content_type || opts[:content_type] || @content_types[opts[:format]],
        response_topic: own.response_topic || opts[:response_topic],
        message_expiry: own.message_expiry || opts[:message_expiry],
        user_properties: opts[:user_properties] ++ own.user_properties ++ time
    })
  end
end

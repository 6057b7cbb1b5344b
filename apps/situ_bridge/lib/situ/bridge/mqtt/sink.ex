defmodule Situ.Bridge.Mqtt.Sink do
  alias Situ.Bridge.Net.ClientSocket
  alias Situ.Bridge.PeerSender

  @schema [
            host: [type: :string, required: true, doc: "The host of the broker."],
            port: [
              type: {:optional, {:integer, 1, 65_535}},
              default: nil,
              doc: "The port of the broker (default: 1883, or 8883 with TLS)."
            ],
            topic: [type: :string, required: true, doc: "The topic to publish to."],
            qos: [
              type: {:in, [0, 1]},
              default: 1,
              doc:
                "1: messages are sent again until the broker acknowledges them. 0: messages are sent only once."
            ],
            retain: [
              type: :boolean,
              default: false,
              doc: "Asks the broker to keep the last message for clients that subscribe later."
            ],
            username: [
              type: {:optional, :string},
              default: nil,
              doc: "The user name for the broker."
            ],
            password: [
              type: {:optional, {:or, [:string, {:fun, 0}]}},
              default: nil,
              doc: "The password, or a function that returns it."
            ]
          ] ++
            ClientSocket.tls_options() ++
            Keyword.drop(PeerSender.options(), [:listening, :wait_for])
  @moduledoc false
  # Publishes a stream to a topic.
  use Situ.Component, inputs: [in: :any], options: @schema
  use PeerSender
  alias Situ.Bridge.Mqtt.Publisher

  def schema, do: @schema

  @impl true
  def init(opts), do: {:ok, PeerSender.new([wait_for: 0] ++ opts)}

  @impl true
  def handle_start(_context, %{opts: opts} = sender) do
    id = "situ-" <> Base.encode16(:crypto.strong_rand_bytes(8), case: :lower)
    port = opts[:port] || if(opts[:tls] in [nil, false], do: 1_883, else: 8_883)
    {:ok, publisher} = Publisher.start_link([id: id, port: port] ++ opts)
    {[], PeerSender.attach_server(sender, Publisher, publisher, nil)}
  end

  @impl true
  def handle_message(:in, message, _context, sender),
    do: PeerSender.send_payload(sender, PeerSender.encode_payload(message, sender.opts))
end

defmodule Situ.Bridge.Mqtt do
  @moduledoc """
  Connects streams with MQTT 5 and 3.1.1: subscribes to topics of any broker (mosquitto, NATS, EMQX ...), and publishes
  streams on topics.

      Situ.Bridge.Mqtt.publish(levels, "broker", "lab/level")
      levels = Situ.Bridge.Mqtt.subscribe(p, "broker", "lab/level")
      raw = Situ.Bridge.Mqtt.subscribe(p, "broker", "sensors/+/temperature", format: :raw)

  Messages are in a format of `Situ.Bridge.Format`, which includes their originating times. With `format: :raw`,
  messages are unchanged bytes. Their originating times are sent as the user property `situ-originating-time`, and
  messages of other programs get the time of arrival. Filters may contain `+` and `#`, and the messages of all matching
  topics arrive as one stream; `envelope: true` adds the topic and the properties (`Situ.Bridge.Mqtt.Message`).

  If the broker is unavailable or restarts, the client reconnects after 50 ms to 5 s:

  - With `qos: 2`, each message is transferred exactly once, over any number of connections, as long as both the process
    and the broker's session live. If the broker loses its session, or a subscriber's program is killed, messages in
    flight arrive again rather than getting lost. If a publisher's program is killed, its unacknowledged messages are
    lost.
  - With `qos: 1` (the default), messages may arrive twice.
  - With `qos: 0`, messages sent without a connection are lost and counted.

  With `qos: 1` or `2`, a publisher keeps at most `high_water_mark:` unacknowledged messages and then makes the stream
  wait. Messages that cannot be read, or whose times do not increase (because they were delivered again), are dropped
  and counted (`Situ.Pipeline.info/1`). A subscription never ends. A subscription with `session:` gets the messages that
  it missed, also after a restart of the program.

  The client speaks MQTT 5 and falls back to 3.1.1 if the broker refuses it. Then there are no properties, and the
  options that are marked with MQTT 5 have no effect.

  Use TLS on networks that you do not control: `tls: true`, or `tls: [authorities: "ca.pem"]` if the broker's
  certificate is signed by a private authority. If the certificate is invalid, the connection is refused, the error is
  logged, and the client tries again.
  """

  alias Situ.Bridge.Mqtt.{ClientOptions, Sink, Subscription}
  alias Situ.Bridge.Net

  @options [
    qos: [
      type: {:in, [0, 1, 2]},
      default: 1,
      doc:
        "2: each message arrives exactly once, also over reconnects; 1: messages are acknowledged, and sent again " <>
          "if the acknowledgement is lost; 0: no acknowledgement."
    ],
    session: [
      type: {:optional, :string},
      default: nil,
      doc:
        "A session name; with `qos: 1` or `2`, the broker keeps messages that the subscriber misses while disconnected."
    ],
    share: [
      type: {:optional, :string},
      default: nil,
      doc: "A group name; the broker sends each message to one of the group's subscribers."
    ],
    envelope: [
      type: :boolean,
      default: false,
      doc: "Values are `Situ.Bridge.Mqtt.Message`, with topic and properties."
    ],
    no_local: [
      type: :boolean,
      default: false,
      doc: "The subscriber does not get messages that it has published itself (MQTT 5)."
    ],
    retain_as_published: [
      type: :boolean,
      default: false,
      doc: "Messages keep their publisher's `retain` flag (MQTT 5)."
    ],
    retain_handling: [
      type: {:in, [0, 1, 2]},
      default: 0,
      doc:
        "0: the broker sends the retained messages; 1: only if the session does not have the subscription yet; " <>
          "2: never (MQTT 5)."
    ],
    receive_maximum: [
      type: {:integer, 1, 65_535},
      default: 1_000,
      doc:
        "The maximum number of messages that the broker sends before they are acknowledged (MQTT 5)."
    ]
  ]
  @schema @options ++ ClientOptions.schema() ++ Net.ClientSocket.tls_options()

  @doc """
  Publishes a stream on a topic; returns the stream.

  #{Situ.Options.docs(Keyword.drop(Sink.schema(), [:host, :topic]))}
  """
  @spec publish(Situ.Stream.t(), String.t(), String.t(), keyword()) :: Situ.Stream.t()
  def publish(stream, host, topic, opts \\ []) do
    opts = ClientOptions.prepare(opts)
    Situ.via(stream, Sink, [host: host, topic: ClientOptions.check_topic!(topic)] ++ opts)
    stream
  end

  @doc """
  Adds a source with the messages of a topic or filter.

  #{Situ.Options.docs(@schema)}

  #{Net.Source.option_docs()}
  """
  @spec subscribe(Situ.Pipeline.t(), String.t(), String.t(), keyword()) :: Situ.Stream.t()
  def subscribe(p, host, topic, opts \\ []) do
    {mqtt_opts, opts} = Keyword.split(opts, Keyword.keys(@schema))
    mqtt_opts = mqtt_opts |> ClientOptions.prepare() |> Situ.Options.validate!(@schema)
    id = mqtt_opts[:session] || ClientOptions.random_id()
    most = opts[:most] || Net.Source.schema()[:most][:default]
    arg = [id: id, topic: topic, most: most] ++ Keyword.drop(mqtt_opts, [:port, :tls])
    source_opts = [tls: mqtt_opts[:tls]] ++ opts
    Net.Source.connect(p, {Subscription, arg}, host, ClientOptions.port(mqtt_opts), source_opts)
  end

  @doc "Same as `publish/4`: all bridges have a function `sink` that sends a stream."
  @spec sink(Situ.Stream.t(), String.t(), String.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, host, topic, opts \\ []), do: publish(stream, host, topic, opts)

  @doc "Same as `subscribe/4`: all bridges have a function `source` that receives a stream."
  @spec source(Situ.Pipeline.t(), String.t(), String.t(), keyword()) :: Situ.Stream.t()
  def source(p, host, topic, opts \\ []), do: subscribe(p, host, topic, opts)
end

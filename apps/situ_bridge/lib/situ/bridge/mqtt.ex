defmodule Situ.Bridge.Mqtt do
  @moduledoc """
  Connects streams with MQTT 3.1.1: subscribes to topics of any broker (mosquitto, NATS, EMQX ...), and publishes
  streams on topics.

      Situ.Bridge.Mqtt.publish(levels, "broker", "lab/level")
      levels = Situ.Bridge.Mqtt.subscribe(p, "broker", "lab/level")
      raw = Situ.Bridge.Mqtt.subscribe(p, "broker", "sensors/+/temperature", format: :raw)

  Messages are in a format of `Situ.Bridge.Format`, which includes their originating times. With `format: :raw`,
  messages are unchanged bytes whose originating time is the time of arrival. Filters may contain `+` and `#`, and the
  messages of all matching topics arrive as one stream.

  If the broker is unavailable or restarts, the client reconnects after 50 ms to 5 s. With `qos: 1` (the default), a
  publisher keeps at most `high_water_mark:` unacknowledged messages and then makes the stream wait. With `qos: 0`,
  messages sent without a connection are lost and counted. Messages that cannot be read, or whose times do not
  increase (because they were delivered again), are dropped and counted (`Situ.Pipeline.info/1`). A subscription never
  ends.

  Use TLS on networks that you do not control: `tls: true`, or `tls: [authorities: "ca.pem"]` if the broker's
  certificate is signed by a private authority. If the certificate is invalid, the connection is refused, the error is
  logged, and the client tries again.
  """

  alias Situ.Bridge.Mqtt.{Sink, Subscription}
  alias Situ.Bridge.Net

  @options [
    port: [
      type: {:optional, {:integer, 1, 65_535}},
      default: nil,
      doc: "The broker's port; by default 1883, or 8883 with TLS."
    ],
    qos: [
      type: {:in, [0, 1]},
      default: 1,
      doc:
        "1: messages are acknowledged, and sent again if the acknowledgement is lost; 0: no acknowledgement."
    ],
    session: [
      type: {:optional, :string},
      default: nil,
      doc:
        "A session name; with `qos: 1`, the broker keeps messages that the subscriber misses while disconnected."
    ],
    username: [type: {:optional, :string}, default: nil, doc: "The user name for the login."],
    password: [
      type: {:optional, {:or, [:string, {:fun, 0}]}},
      default: nil,
      doc:
        "The password, or a function that returns it. It is hidden in the graph and in the states of processes."
    ]
  ]
  @schema @options ++ Net.ClientSocket.tls_options()

  @doc """
  Publishes a stream on a topic; returns the stream.

  #{Situ.Options.docs(Keyword.drop(Sink.schema(), [:host, :topic]))}
  """
  @spec publish(Situ.Stream.t(), String.t(), String.t(), keyword()) :: Situ.Stream.t()
  def publish(stream, host, topic, opts \\ []) do
    Situ.via(stream, Sink, [host: host, topic: topic] ++ hide_password(opts))
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
    mqtt_opts = mqtt_opts |> hide_password() |> Situ.Options.validate!(@schema)

    id =
      mqtt_opts[:session] || "situ-" <> Base.encode16(:crypto.strong_rand_bytes(8), case: :lower)

    arg = [id: id, topic: topic] ++ Keyword.drop(mqtt_opts, [:port, :tls])
    port = mqtt_opts[:port] || if(mqtt_opts[:tls] in [nil, false], do: 1_883, else: 8_883)
    Net.Source.connect(p, {Subscription, arg}, host, port, [tls: mqtt_opts[:tls]] ++ opts)
  end

  # Options are part of the graph and of process states, which logs and observers show.
  defp hide_password(opts) do
    case opts[:password] do
      password when is_binary(password) -> Keyword.put(opts, :password, fn -> password end)
      _function_or_none -> opts
    end
  end

  @doc "Same as `publish/4`: all bridges have a function `sink` that sends a stream."
  @spec sink(Situ.Stream.t(), String.t(), String.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, host, topic, opts \\ []), do: publish(stream, host, topic, opts)

  @doc "Same as `subscribe/4`: all bridges have a function `source` that receives a stream."
  @spec source(Situ.Pipeline.t(), String.t(), String.t(), keyword()) :: Situ.Stream.t()
  def source(p, host, topic, opts \\ []), do: subscribe(p, host, topic, opts)
end

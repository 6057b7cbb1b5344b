defmodule Situ.Bridge.Mqtt do
  alias Situ.Bridge.Mqtt.{Sink, Subscription}
  alias Situ.Bridge.Net

  @own [
    port: [
      type: {:optional, {:integer, 1, 65_535}},
      default: nil,
      doc: "The broker's port (default: 1883, with TLS 8883)."
    ],
    qos: [
      type: {:in, [0, 1]},
      default: 1,
      doc: "1: messages are acknowledged, and come again where that was lost; 0: they are not."
    ],
    session: [
      type: {:optional, :string},
      default: nil,
      doc:
        "A name under which the broker keeps (with `qos: 1`) what this subscriber misses while it is away."
    ],
    username: [type: {:optional, :string}, default: nil, doc: "As whom to log in."],
    password: [
      type: {:optional, {:or, [:string, {:fun, 0}]}},
      default: nil,
      doc:
        "The password, or a function that returns it. Neither the graph nor the state of a process shows it."
    ]
  ]
  @schema @own ++ Net.Dial.options()
  @moduledoc """
  MQTT 3.1.1: topics of any broker (mosquitto, NATS, EMQX ...) as streams, and streams as topics.

      Situ.Bridge.Mqtt.publish(levels, "broker", "lab/level")
      levels = Situ.Bridge.Mqtt.subscribe(p, "broker", "lab/level")
      raw = Situ.Bridge.Mqtt.subscribe(p, "broker", "sensors/+/temperature", format: :raw)

  Messages are in a format of `Situ.Bridge.Format`, whose originating times go along; with `format: :raw` they are the
  bytes as they are, and their time is that of arrival. Filters may have `+` and `#`; those of several topics come as
  one stream.

  A broker that is not there yet is waited for, and one that was restarted is found again, after 50 ms to 5 s. With
  `qos: 1` (the default) a publisher keeps what the broker has not acknowledged, at most `high_water_mark:` messages,
  and then makes the stream wait; with `qos: 0` what is sent while there is no broker is lost, and counted. Messages
  that cannot be read, or whose times do not increase (they came again), are left out and counted
  (`Situ.Pipeline.info/1`). A subscription is endless.

  Over other networks than one's own take TLS: `tls: true`, or `tls: [authorities: "ca.pem"]` for a broker with a
  certificate of one's own authority. A broker whose certificate is not good is not spoken with; that is logged, and
  tried again.
  """

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
  A source of the messages of a topic or filter.

  #{Situ.Options.docs(@schema)}

  #{Net.Source.docs()}
  """
  @spec subscribe(Situ.Pipeline.t(), String.t(), String.t(), keyword()) :: Situ.Stream.t()
  def subscribe(p, host, topic, opts \\ []) do
    {own, opts} = Keyword.split(opts, Keyword.keys(@schema))
    own = own |> hide_password() |> Situ.Options.validate!(@schema)
    id = own[:session] || "situ-" <> Base.encode16(:crypto.strong_rand_bytes(8), case: :lower)
    arg = [id: id, topic: topic] ++ Keyword.drop(own, [:port, :tls])
    port = own[:port] || if(own[:tls] in [nil, false], do: 1_883, else: 8_883)
    Net.Source.connect(p, {Subscription, arg}, host, port, [tls: own[:tls]] ++ opts)
  end

  # Options go into the graph and into the states of processes, which logs and observers show.
  defp hide_password(opts) do
    case opts[:password] do
      password when is_binary(password) -> Keyword.put(opts, :password, fn -> password end)
      _function_or_none -> opts
    end
  end

  @doc "The name that all bridges have for their way out: `publish/4`."
  @spec sink(Situ.Stream.t(), String.t(), String.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, host, topic, opts \\ []), do: publish(stream, host, topic, opts)

  @doc "The name that all bridges have for their way in: `subscribe/4`."
  @spec source(Situ.Pipeline.t(), String.t(), String.t(), keyword()) :: Situ.Stream.t()
  def source(p, host, topic, opts \\ []), do: subscribe(p, host, topic, opts)
end

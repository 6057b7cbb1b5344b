defmodule Situ.Bridge.Mqtt.ClientOptions do
  @moduledoc false
  # The options that publishers and subscribers have in common.
  alias Situ.Error

  @will [
    topic: [type: :string, required: true, doc: "The topic of the will."],
    payload: [type: :string, default: "", doc: "The bytes of the will."],
    qos: [type: {:in, [0, 1, 2]}, default: 1, doc: "The quality of service of the will."],
    retain: [type: :boolean, default: false, doc: "Whether the broker keeps the will."],
    delay: [
      type: {:optional, {:integer, 0, 4_294_967_295}},
      default: nil,
      doc: "How long the broker waits for a new connection first, s."
    ],
    content_type: [type: {:optional, :string}, default: nil, doc: "The media type of the will."]
  ]

  @schema [
    port: [
      type: {:optional, {:integer, 1, 65_535}},
      default: nil,
      doc: "The broker's port; by default 1883, or 8883 with TLS."
    ],
    version: [
      type: {:in, [nil, 5, 4]},
      default: nil,
      doc:
        "The protocol level: 5 for MQTT 5, 4 for MQTT 3.1.1. By default 5, and 4 if the broker does not support 5."
    ],
    keep_alive: [
      type: {:integer, 0, 65_535},
      default: 60,
      doc:
        "How long the connection may be silent, s. The client pings the broker twice in this time and reconnects if " <>
          "nothing comes back. The broker disconnects a client, and publishes its will, after one and a half times " <>
          "this time. 0: no pings, and a broker whose machine is gone is not noticed."
    ],
    session_expiry: [
      type: {:integer, 0, 4_294_967_295},
      default: 3_600,
      doc: "How long the broker keeps the session of a client that is not connected, s."
    ],
    will: [
      type: {:optional, :keyword},
      default: nil,
      doc:
        "The message that the broker publishes if the connection ends unexpectedly: `topic:`, `payload:`, `qos:`, " <>
          "`retain:`, `delay:` (s), `content_type:`."
    ],
    username: [type: {:optional, :string}, default: nil, doc: "The user name for the login."],
    password: [
      type: {:optional, {:or, [:string, {:fun, 0}]}},
      default: nil,
      doc:
        "The password, or a function that returns it. It is hidden in the graph and in the states of processes."
    ]
  ]

  @doc "Returns the options."
  @spec schema() :: Situ.Options.schema()
  def schema, do: @schema

  @doc "Hides the password, because options are part of the graph and of process states; checks the will."
  @spec prepare(keyword()) :: keyword()
  def prepare(opts) do
    opts
    |> Keyword.replace_lazy(:password, &hide_password/1)
    |> Keyword.replace_lazy(:will, &(&1 && Situ.Options.validate!(&1, @will)))
  end

  defp hide_password(password) when is_binary(password), do: fn -> password end
  defp hide_password(function_or_none), do: function_or_none

  @doc "Raises `Situ.Error` (`:invalid_topic`) unless messages can be published on the topic."
  @spec check_topic!(String.t()) :: String.t()
  def check_topic!(topic) do
    if topic == "" or String.contains?(topic, ["+", "#", <<0>>]) or byte_size(topic) > 65_535 do
      raise Error.new(:invalid_topic, "#{inspect(topic)} is no topic to publish on",
              why: "a topic has 1 to 65535 bytes, and no +, # or zero byte",
              fix: "name one topic, such as \"lab/level\""
            )
    end

    topic
  end

  @doc """
  Returns the interval between two pings, ms (0: none). A broker's reply with MQTT 5 may set another time than the
  client's option.
  """
  @spec ping_interval_ms(keyword(), map()) :: non_neg_integer()
  def ping_interval_ms(opts, properties \\ %{}),
    do: 500 * (properties[:server_keep_alive] || opts[:keep_alive] || 0)

  @doc "Returns the broker's port."
  @spec port(keyword()) :: :inet.port_number()
  def port(opts), do: opts[:port] || if(opts[:tls] in [nil, false], do: 1_883, else: 8_883)

  @doc "Returns a new client identifier."
  @spec random_id() :: String.t()
  def random_id, do: "situ-" <> Base.encode16(:crypto.strong_rand_bytes(8), case: :lower)
end

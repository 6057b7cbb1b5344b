defmodule Situ.CLI.Store.Transport do
  @moduledoc false
  # Provides the addresses, publishers and subscribers of the systems that `situ store send` and `record` use.
  alias Situ.Bridge.{Mcap, Mqtt, Ros, Ros2, ZeroMQ}
  alias Situ.Bridge.Ros.{Definition, Library}
  alias Situ.CLI.Option
  alias Situ.Store

  @systems ["zeromq", "mqtt", "ros", "ros2"]
  @formats %{"csv" => :csv, "json" => :json, "message_pack" => :message_pack, "situ" => :situ}
  @addresses %{
    "zeromq" => "tcp://127.0.0.1:5555",
    "mqtt" => "127.0.0.1:1883",
    "ros" => "http://localhost:11311",
    "ros2" => "tcp/127.0.0.1:7447"
  }

  @spec wire_options() :: [Option.t()]
  def wire_options do
    [
      Option.new(:system, @systems, "the system to exchange messages with",
        short: :y,
        default: "zeromq"
      ),
      Option.new(
        :address,
        :string,
        "ZeroMQ: tcp://HOST:PORT; MQTT: the broker's HOST:PORT; ROS 1: its master; ROS 2: Zenoh's router",
        short: :a,
        value: "ADDRESS"
      ),
      Option.new(
        :format,
        @formats |> Map.keys() |> Enum.sort(),
        "the message format (ZeroMQ, MQTT)",
        short: :m
      )
    ]
  end

  @doc "Returns the given address, or the system's default."
  @spec resolve_address(keyword()) :: String.t()
  def resolve_address(opts) do
    elsewhere = if opts[:system] == "ros", do: System.get_env("ROS_MASTER_URI")
    opts[:address] || elsewhere || Map.fetch!(@addresses, opts[:system])
  end

  @doc "Opens a recording. For ROS, messages are read as maps, so that fields without a counterpart in Situ are kept."
  @spec open_recording!(Path.t(), keyword()) :: Store.t()
  def open_recording!(path, opts) do
    store = Store.open!(path)

    if opts[:system] in ["ros", "ros2"] and store.module in [Mcap, Ros.Bag, Ros.Db3],
      do: Store.open!(path, reader_opts: [messages: :maps]),
      else: store
  end

  @doc "Returns a function that publishes a stream; it takes the stream, its topic and its description."
  @spec stream_publisher(Situ.Pipeline.t(), keyword()) ::
          (Situ.Stream.t(), String.t(), Store.StreamInfo.t() -> Situ.Stream.t())
  def stream_publisher(p, opts), do: system_publisher(opts[:system], p, opts)

  defp system_publisher("zeromq", p, opts) do
    socket = ZeroMQ.publisher(p, resolve_address(opts))
    given = [format: message_format(opts), wait_for: opts[:subscribers], linger: 10_000]
    fn stream, topic, _info -> ZeroMQ.publish(stream, socket, [topic: topic] ++ given) end
  end

  defp system_publisher("mqtt", _p, opts) do
    {host, port} = broker_address(opts)
    given = [port: port, format: message_format(opts), linger: 10_000]
    fn stream, topic, _info -> Mqtt.publish(stream, host, topic, given) end
  end

  defp system_publisher("ros", _p, opts) do
    given = [master: resolve_address(opts), wait_for: opts[:subscribers], linger: 10_000]

    fn stream, topic, info ->
      Ros.publish(stream, ros_name(topic), ros_type_option(info) ++ given)
    end
  end

  defp system_publisher("ros2", _p, opts) do
    given = [router: resolve_address(opts), linger: 10_000]

    fn stream, topic, info ->
      Ros2.publish(stream, ros_name(topic), ros_type_option(info) ++ given)
    end
  end

  @doc "Subscribes to a topic and returns it as a stream."
  @spec subscribe_topic(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def subscribe_topic(p, topic, opts) do
    case opts[:system] do
      "zeromq" ->
        ZeroMQ.subscribe(p, resolve_address(opts), topic: topic, format: message_format(opts))

      "mqtt" ->
        {host, port} = broker_address(opts)
        Mqtt.subscribe(p, host, topic, port: port, format: message_format(opts))

      "ros" ->
        Ros.subscribe(p, topic, master: resolve_address(opts))

      "ros2" ->
        Ros2.subscribe(p, topic, router: resolve_address(opts))
    end
  end

  defp message_format(opts), do: @formats[opts[:format] || "json"]

  defp broker_address(opts) do
    case Regex.run(~r/\A(.+?)(?::(\d{1,5}))?\z/, resolve_address(opts)) do
      [_, host] -> {host, 1_883}
      [_, host, port] -> {host, String.to_integer(port)}
      nil -> throw({:usage, "--address needs the broker's HOST:PORT"})
    end
  end

  # Names in ROS consist of letters, digits, _ and /.
  defp ros_name(topic),
    do: "/" <> (topic |> String.trim_leading("/") |> String.replace(~r/[^A-Za-z0-9_\/]/, "_"))

  # Messages recorded from ROS are sent with their original type.
  defp ros_type_option(%{type_name: type}) when is_binary(type) do
    plain = Definition.strip_kind(type)
    if Library.fetch(plain) == :error, do: [], else: [ros_type: plain]
  end

  defp ros_type_option(_info), do: []
end

defmodule Situ.Bridge.Ros do
  @moduledoc """
  Connects streams with live topics, services and parameters of ROS 1. It is written in Elixir and does not need ROS
  on this machine.

      scans = Situ.Bridge.Ros.subscribe(p, "/scan", master: "http://robot:11311")
      Situ.Bridge.Ros.publish(images, "/camera/image_raw")
      {:ok, %{"sum" => 5}} = Situ.Bridge.Ros.call("/add", definition, %{"a" => 2, "b" => 3})

  Messages of any type are decoded with the definition that their publisher sends. Standard messages become Situ's
  types (table below), and other messages become maps with string keys and times in nanoseconds. The stamp of a header
  becomes the originating time (including simulated time), and vice versa. Each stream is a separate node.

  If a master or a publisher is unavailable or restarts, the node waits and reconnects. A slow subscriber loses
  messages beyond `high_water_mark:`, which are counted. Messages that cannot be read, or whose times do not increase,
  are dropped and counted (`Situ.Pipeline.info/1`). ROS 1 has neither encryption nor authentication. If the master is
  on this machine, a node listens only on 127.0.0.1; otherwise it listens on all interfaces.

  ## Standard types

  All readers and writers of ROS messages (topics, bags, MCAP) convert these types. Messages with a standard name but
  invalid values or other fields stay maps. With `messages: :maps`, a reader returns all messages as maps, including
  covariances and frames of reference.

  | ROS | Situ |
  |---|---|
  | `sensor_msgs/Image` (`mono8`, `mono16`, `rgb8`, `bgr8`, `rgba8`, `bgra8`, `8UC1`, `8UC3`, `16UC1`) | `Situ.Image`; `16UC1` is a `Situ.DepthImage` in millimetres |
  | `sensor_msgs/CompressedImage` (JPEG, PNG) | `Situ.EncodedImage` |
  | `sensor_msgs/PointCloud2` (x, y, z, rgb and intensity) | `Situ.PointCloud` |
  | `sensor_msgs/CameraInfo` | `Situ.CameraIntrinsics` |
  | `sensor_msgs/Imu` | `Situ.ImuReading` |
  | `sensor_msgs/NavSatFix` | `Situ.GeoPoint`; a map without a fix |
  | `sensor_msgs/JointState` | `Situ.JointState` |
  | `tf2_msgs/TFMessage`, `tf/tfMessage` | a list of `Situ.Transform`, marked as static on `/tf_static` |
  | `geometry_msgs/TransformStamped` | `Situ.Transform` |
  | `geometry_msgs/Pose`, `PoseStamped` | `Situ.Pose` |
  | `audio_common_msgs/AudioData` | written from `Situ.AudioBuffer`; read as a map, because it has no format |
  | `geometry_msgs/Point`, `Point32`, `Vector3` | `Situ.Point3` |
  | `rosgraph_msgs/Clock` | the simulated time, an integer |
  | `std_msgs/String`, `Bool`, `Int8` ... `Float64` | the value |
  """
  alias Situ.Bridge.Ros.{Address, Registrar, Service, Sink, Source}
  alias Situ.Error

  @doc """
  Publishes a stream on a topic; returns the stream.

  #{Situ.Options.docs(Keyword.delete(Sink.schema(), :topic))}
  """
  @spec publish(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def publish(stream, topic, opts \\ []) do
    Situ.via(stream, Sink, [topic: topic] ++ opts)
    stream
  end

  @doc """
  Adds a source with the messages of a topic.

  #{Situ.Options.docs(Keyword.delete(Source.schema(), :topic))}
  """
  @spec subscribe(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def subscribe(p, topic, opts \\ []),
    do: Situ.source(p, Source, [topic: topic, outputs: [out: opts[:type] || :any]] ++ opts)

  @doc """
  Calls a service with a message of its request type; returns `{:ok, message}` with its response. `definition` is the
  text of its `.srv` file. Options: `timeout:` (5,000 ms), and the options below. Errors: `:ros_unreachable`,
  `:ros_refused` (the service does not exist, has a different type, or returned an error), `:bad_definition`,
  `:not_writable`.

  #{Situ.Options.docs(Address.options())}
  """
  @spec call(String.t(), String.t(), map(), keyword()) :: {:ok, map()} | {:error, Error.t()}
  defdelegate call(service, definition, request, opts \\ []), to: Service

  @doc """
  Offers a service. For each caller, `fun` runs in a separate process; it receives a request and returns
  `{:ok, response}` or `{:error, text}`. The service ends with `stop/1` or with the calling process. `type` is the
  type of the `.srv` file (`"std_srvs/SetBool"`). Options as in `call/4`.
  """
  @spec serve(
          String.t(),
          String.t(),
          String.t(),
          (map() -> {:ok, map()} | {:error, String.t()}),
          keyword()
        ) ::
          {:ok, pid()} | {:error, Error.t()}
  defdelegate serve(service, type, definition, fun, opts \\ []), to: Service

  @doc "Stops a service."
  @spec stop(pid()) :: :ok
  defdelegate stop(server), to: Service

  @doc """
  Returns a parameter of the master: a number, boolean, string, list or map. Errors as in `call/4`. Option: `master:`.
  """
  @spec get_param(String.t(), keyword()) :: {:ok, term()} | {:error, Error.t()}
  def get_param(name, opts \\ []), do: call_master("getParam", [Address.resolve_name(name)], opts)

  @doc "Sets a parameter of the master."
  @spec set_param(String.t(), term(), keyword()) :: :ok | {:error, Error.t()}
  def set_param(name, value, opts \\ []) do
    with {:ok, _} <- call_master("setParam", [Address.resolve_name(name), value], opts), do: :ok
  end

  @doc "Returns the published topics as `{topic, type}`."
  @spec list_topics(keyword()) :: {:ok, [{String.t(), String.t()}]} | {:error, Error.t()}
  def list_topics(opts \\ []) do
    with {:ok, list} <- call_master("getPublishedTopics", [""], opts),
         do: {:ok, for([topic, type] <- list, do: {topic, type})}
  end

  defp call_master(method, arguments, opts) do
    address = Address.new(opts)
    Registrar.call_master(address, method, [address.node | arguments])
  end

  @doc "Same as `publish/3`: all bridges have a function `sink` that sends a stream."
  @spec sink(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, topic, opts \\ []), do: publish(stream, topic, opts)

  @doc "Same as `subscribe/3`: all bridges have a function `source` that receives a stream."
  @spec source(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def source(p, topic, opts \\ []), do: subscribe(p, topic, opts)
end

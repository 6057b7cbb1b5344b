defmodule Situ.Bridge.Ros2 do
  @moduledoc """
  Connects streams with live topics and services of ROS 2 as implemented by `rmw_zenoh`. It does not need ROS on this
  machine. It needs a Zenoh router (`rmw_zenohd`) on the network and the program `zenoh_port`, which is not part of
  the ordinary build (`bin/setup --with ros2` builds it).

      imu = Situ.Bridge.Ros2.subscribe(p, "/imu", router: "tcp/robot:7447")
      Situ.Bridge.Ros2.publish(images, "/camera/image_raw", frame: "camera")
      add = "int64 a\nint64 b\n---\nint64 sum"
      type = "example_interfaces/srv/AddTwoInts"
      {:ok, %{"sum" => 5}} = Situ.Bridge.Ros2.call("/add", type, add, %{"a" => 2, "b" => 3})

  Standard messages become Situ's types (the table in `Situ.Bridge.Ros`), and other messages become maps with string
  keys, according to `definition:`. The originating time is the stamp of the header, or else the time of sending. Each
  stream is a separate node, visible to `ros2 topic list`. Types are identified by ROS's own hash.

  With `latch: true` a publisher keeps its last messages for later subscribers, and a subscriber receives such
  messages (durability TRANSIENT_LOCAL; `depth:` is their number).

  If the router is unavailable or restarts, the client waits and reconnects. A slow subscriber loses messages beyond
  `high_water_mark:`; a publisher's stream waits for the network. Messages that cannot be read, or whose times do not
  increase, are dropped and counted (`Situ.Pipeline.info/1`). Parameters are services of each node
  (`rcl_interfaces/srv/GetParameters`). Actions are not supported.
  """
  alias Situ.Bridge.Ros2.{Client, Server, Sink, Source, Zenoh}
  alias Situ.Error

  @doc """
  Publishes a stream on a topic; returns the stream. Error of the pipeline: `:no_zenoh_port`.

  #{Situ.Options.docs(Keyword.delete(Sink.schema(), :topic))}
  """
  @spec publish(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def publish(stream, topic, opts \\ []) do
    Situ.via(stream, Sink, [topic: topic] ++ opts)
    stream
  end

  @doc """
  Adds a source with the messages of a topic. Error of the pipeline: `:no_zenoh_port`.

  #{Situ.Options.docs(Keyword.delete(Source.schema(), :topic))}
  """
  @spec subscribe(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def subscribe(p, topic, opts \\ []),
    do: Situ.source(p, Source, [topic: topic, outputs: [out: opts[:type] || :any]] ++ opts)

  @doc """
  Calls a service with a message of its request type; returns `{:ok, message}` with its response. `type` is
  `"package/srv/Name"`, and `definition` is the text of its `.srv` file. Each call opens a session; use `client/4` for
  frequent calls. Options: `timeout:` (5,000 ms), and the options below.

  Errors: `:ros_refused` (the service is not offered with this definition, or returned an error), `:ros_unreachable`
  (no router, or no response in time), `:bad_definition`, `:not_writable`, `:no_zenoh_port`.

  #{Situ.Options.docs(Zenoh.options())}
  """
  @spec call(String.t(), String.t(), String.t(), map(), keyword()) ::
          {:ok, map()} | {:error, Error.t()}
  defdelegate call(service, type, definition, request, opts \\ []), to: Client

  @doc "Starts a client of a service for `ask/3`. It ends with `stop/1` or the calling process. Options as in `call/5`."
  @spec client(String.t(), String.t(), String.t(), keyword()) ::
          {:ok, pid()} | {:error, Error.t()}
  defdelegate client(service, type, definition, opts \\ []), to: Client, as: :start_link

  @doc "Calls the service of a client; may be called concurrently from any process. Errors as in `call/5`."
  @spec ask(pid(), map(), timeout :: pos_integer()) :: {:ok, map()} | {:error, Error.t()}
  defdelegate ask(client, request, timeout \\ 5_000), to: Client, as: :send_request

  @doc """
  Offers a service. For each request, `fun` runs in a separate process; it receives the request and returns
  `{:ok, response}`. ROS 2 has no error responses: `{:error, text}` reaches only callers that use Situ, other callers
  wait until they time out. The service ends with `stop/1` or with the calling process. Errors: `:ros_unreachable` (no
  router within `timeout:`, 5,000 ms), `:bad_definition`, `:no_zenoh_port`. Options as in `call/5`.
  """
  @spec serve(
          String.t(),
          String.t(),
          String.t(),
          (map() -> {:ok, map()} | {:error, String.t()}),
          keyword()
        ) ::
          {:ok, pid()} | {:error, Error.t()}
  defdelegate serve(service, type, definition, fun, opts \\ []), to: Server, as: :start_link

  @doc "Stops a service or a client."
  @spec stop(pid()) :: :ok
  defdelegate stop(pid), to: Client

  @doc "Same as `publish/3`: all bridges have a function `sink` that sends a stream."
  @spec sink(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, topic, opts \\ []), do: publish(stream, topic, opts)

  @doc "Same as `subscribe/3`: all bridges have a function `source` that receives a stream."
  @spec source(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def source(p, topic, opts \\ []), do: subscribe(p, topic, opts)
end

defmodule Situ.Bridge.Ros2 do
  @moduledoc """
  Live topics and services of ROS 2, as `rmw_zenoh` has them on Zenoh: no ROS is needed on this machine, but Zenoh's
  router (`rmw_zenohd`) somewhere, and the program `zenoh_port` (`bin/setup --with ros2` builds it; it is no part of the
  ordinary build).

      imu = Situ.Bridge.Ros2.subscribe(p, "/imu", router: "tcp/robot:7447")
      Situ.Bridge.Ros2.publish(pictures, "/camera/image_raw", frame: "camera")
      add = "int64 a\nint64 b\n---\nint64 sum"
      type = "example_interfaces/srv/AddTwoInts"
      {:ok, %{"sum" => 5}} = Situ.Bridge.Ros2.call("/add", type, add, %{"a" => 2, "b" => 3})

  Standard messages are Situ's types (`Situ.Bridge.Ros.Standard`), others maps with string keys, by `definition:`. The
  stamp of a header becomes the originating time, or else the time at which the sender sent it. Each stream is a node of
  its own, seen by `ros2 topic list`. Types are told apart by ROS's own hash.

  With `latch: true` a publisher keeps its last messages for those who subscribe later, and a subscriber gets such
  messages (durability TRANSIENT_LOCAL; `depth:` says how many).

  A router that is not there yet is waited for, and one that was restarted is found again. A subscriber that is too slow
  loses messages beyond `high_water_mark:`; a publisher's stream waits for the network. Messages that cannot be read, or
  whose times do not increase, are left out and counted (`Situ.Pipeline.info/1`). Parameters are services of each node
  (`rcl_interfaces/srv/GetParameters`); actions are not there.
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
  A source of a topic's messages. Error of the pipeline: `:no_zenoh_port`.

  #{Situ.Options.docs(Keyword.delete(Source.schema(), :topic))}
  """
  @spec subscribe(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def subscribe(p, topic, opts \\ []),
    do: Situ.source(p, Source, [topic: topic, outputs: [out: opts[:type] || :any]] ++ opts)

  @doc """
  Calls a service: a message of its request type, `{:ok, message}` of its response type. `type` is
  `"package/srv/Name"`, `definition` the text of its `.srv`. It opens a session each time; who calls often takes
  `client/4`. Options: `timeout:` (5,000 ms), and those below.

  Errors: `:ros_refused` (nobody offers it with this definition, or it says no), `:ros_unreachable` (no router, or no
  answer in time), `:bad_definition`, `:not_writable`, `:no_zenoh_port`.

  #{Situ.Options.docs(Zenoh.options())}
  """
  @spec call(String.t(), String.t(), String.t(), map(), keyword()) ::
          {:ok, map()} | {:error, Error.t()}
  defdelegate call(service, type, definition, request, opts \\ []), to: Client

  @doc "One who calls a service, for `ask/3`, until `stop/1` or the end of the calling process. Options as `call/5`."
  @spec client(String.t(), String.t(), String.t(), keyword()) ::
          {:ok, pid()} | {:error, Error.t()}
  defdelegate client(service, type, definition, opts \\ []), to: Client, as: :start_link

  @doc "Calls the service of a client, from any process, also many at once. Errors as `call/5`."
  @spec ask(pid(), map(), timeout :: pos_integer()) :: {:ok, map()} | {:error, Error.t()}
  defdelegate ask(client, request, timeout \\ 5_000), to: Client

  @doc """
  Offers a service: `fun` gets a request and answers `{:ok, response}`; in a process of its own for each request. ROS 2
  knows no refusals: `{:error, text}` is seen by callers of Situ, others wait until they give up. Ends with `stop/1`,
  and with the calling process. Errors: `:ros_unreachable` (no router within `timeout:`, 5,000 ms), `:bad_definition`,
  `:no_zenoh_port`. Options as `call/5`.
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

  @doc "Ends a service or a client."
  @spec stop(pid()) :: :ok
  defdelegate stop(pid), to: Client

  @doc "The name that all bridges have for their way out: `publish/3`."
  @spec sink(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, topic, opts \\ []), do: publish(stream, topic, opts)

  @doc "The name that all bridges have for their way in: `subscribe/3`."
  @spec source(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def source(p, topic, opts \\ []), do: subscribe(p, topic, opts)
end

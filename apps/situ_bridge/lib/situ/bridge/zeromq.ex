defmodule Situ.Bridge.ZeroMQ do
  @moduledoc """
  Exchanges messages over ZeroMQ (TCP) with programs in any language: publish and subscribe, push and pull.

      Situ.Bridge.ZeroMQ.publish(levels, "tcp://*:5555", topic: "levels")
      levels = Situ.Bridge.ZeroMQ.subscribe(p, "tcp://robot:5555", topic: "levels")
      Situ.Bridge.ZeroMQ.push(jobs, "tcp://*:5556")
      jobs = Situ.Bridge.ZeroMQ.pull(p, "tcp://robot:5556")

  In Python: `topic, payload = socket.recv_multipart()`, and `json.loads(payload)` has the keys `originatingTime` and
  `message`.

  A published message has two frames: the topic, and the message in a format of `Situ.Bridge.Format`, as in \\psi's
  `NetMQWriter` and `NetMQSource`. A pushed message has only the second frame. The sockets behave like ZeroMQ's:

    * either side may bind (`bind: true`, the default for `publish/3` and `push/3`) or connect; broken connections are
      reestablished after 50 ms to 5 s, and unavailable peers are retried;
    * a publisher sends only to subscribers; messages without a subscriber, and messages beyond the high-water mark of
      a slow subscriber, are dropped and counted; a pusher distributes messages among its peers in turn and makes the
      stream wait if no peer has room;
    * ZeroMQ's subscriptions are prefixes; `subscribe/3` keeps only messages of exactly its topic unless
      `prefix: true`.

  These sources never end, even if no message arrives or the sender disconnects. Messages that cannot be read, or
  whose times do not increase, are dropped and counted (`Situ.Pipeline.info/1`). Any peer may connect to a bound
  socket without authentication, so bind to 127.0.0.1 or to a network that you control.
  """
  alias Situ.Bridge.ZeroMQ.{SharedPublisher, Sink, Source}

  @publisher Keyword.take(Sink.schema(), [:bind, :high_water_mark])

  @doc """
  Creates a publishing socket for several streams; call it during `build` and pass it to `publish/3` instead of an
  address.

      out = Situ.Bridge.ZeroMQ.publisher(p, "tcp://*:5555")
      Situ.Bridge.ZeroMQ.publish(levels, out, topic: "levels")
      Situ.Bridge.ZeroMQ.publish(faces, out, topic: "faces")

  #{Situ.Options.docs(@publisher)}
  """
  @spec publisher(Situ.Pipeline.t(), String.t(), keyword()) :: SharedPublisher.t()
  def publisher(%Situ.Graph.Handle{} = p, address, opts \\ []),
    do: SharedPublisher.start(p.pid, address, Situ.Options.validate!(opts, @publisher))

  @doc """
  Publishes a stream; returns the stream.

  #{Situ.Options.docs(Keyword.drop(Sink.schema(), [:address, :shared, :socket]))}
  """
  @spec publish(Situ.Stream.t(), String.t() | SharedPublisher.t(), keyword()) :: Situ.Stream.t()
  def publish(stream, %SharedPublisher{} = shared, opts) do
    SharedPublisher.expect_stream(shared)
    Situ.via(stream, Sink, [socket: :pub, shared: shared] ++ opts)
    stream
  end

  def publish(stream, address, opts), do: add_sink(stream, :pub, address, opts)

  @doc "Pushes a stream to the peers that pull; returns the stream. Options as in `publish/3`, without a topic."
  @spec push(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def push(stream, address, opts \\ []), do: add_sink(stream, :push, address, opts)

  @doc """
  Adds a source with the messages of a topic.

  #{Situ.Options.docs(Keyword.drop(Source.schema(), [:address, :socket]))}
  """
  @spec subscribe(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def subscribe(p, address, opts), do: add_source(p, :sub, address, opts)

  @doc "Adds a source with pushed messages. Options as in `subscribe/3`, without a topic."
  @spec pull(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def pull(p, address, opts \\ []), do: add_source(p, :pull, address, opts)

  defp add_sink(stream, socket, address, opts) do
    Situ.via(stream, Sink, [socket: socket, address: address] ++ opts)
    stream
  end

  defp add_source(p, socket, address, opts) do
    outputs = [out: opts[:type] || :any]
    Situ.source(p, Source, [socket: socket, address: address, outputs: outputs] ++ opts)
  end

  @doc "Calls `publish/3` if `topic:` is given, else `push/3`: all bridges have a function `sink` that sends a stream."
  @spec sink(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, address, opts \\ []) do
    if opts[:topic], do: publish(stream, address, opts), else: push(stream, address, opts)
  end

  @doc "Calls `subscribe/3` if `topic:` is given, else `pull/3`: all bridges have a function `source`."
  @spec source(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def source(p, address, opts \\ []) do
    if opts[:topic], do: subscribe(p, address, opts), else: pull(p, address, opts)
  end
end

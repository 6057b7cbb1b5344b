defmodule Situ.Bridge.ZeroMQ do
  @moduledoc """
  ZeroMQ over TCP: publish and subscribe, push and pull, with programs in any language.

      Situ.Bridge.ZeroMQ.publish(levels, "tcp://*:5555", topic: "levels")
      levels = Situ.Bridge.ZeroMQ.subscribe(p, "tcp://robot:5555", topic: "levels")
      Situ.Bridge.ZeroMQ.push(jobs, "tcp://*:5556")
      jobs = Situ.Bridge.ZeroMQ.pull(p, "tcp://robot:5556")

  In Python: `topic, payload = socket.recv_multipart()`, and `json.loads(payload)` has the keys `originatingTime` and
  `message`.

  A published message has two frames, the topic and the message in a format of `Situ.Bridge.Format`, as \\psi's
  `NetMQWriter` and `NetMQSource` have it; pushed ones have the second only. The four sockets behave as ZeroMQ's own:

    * either side may bind (`bind: true`, the default for `publish/3` and `push/3`) or connect; connections that break
      are made again, after 50 ms to 5 s; peers that are not there yet are waited for;
    * a publisher sends to those who subscribed; messages for nobody, and beyond the high-water mark of a slow
      subscriber, are dropped and counted; a pusher serves its peers in turn and makes the stream wait when none has
      room;
    * ZeroMQ's subscriptions are prefixes. `subscribe/3` keeps the messages of exactly its topic unless `prefix: true`.

  A subscription that is never answered is no error, and a sender that goes away does not end the stream: these
  sources are endless. Messages that cannot be read, or whose times do not increase, are left out and counted
  (`Situ.Pipeline.info/1`). Any peer may connect to a bound socket: there is no authentication, so bind to 127.0.0.1
  or a network of your own.
  """
  alias Situ.Bridge.ZeroMQ.{Publisher, Sink, Source}

  @publisher Keyword.take(Sink.schema(), [:bind, :high_water_mark])

  @doc """
  During `build`: one publishing socket for several streams, to be given to `publish/3` in place of an address.

      out = Situ.Bridge.ZeroMQ.publisher(p, "tcp://*:5555")
      Situ.Bridge.ZeroMQ.publish(levels, out, topic: "levels")
      Situ.Bridge.ZeroMQ.publish(faces, out, topic: "faces")

  #{Situ.Options.docs(@publisher)}
  """
  @spec publisher(Situ.Pipeline.t(), String.t(), keyword()) :: Publisher.t()
  def publisher(%Situ.Graph.Handle{} = p, address, opts \\ []),
    do: Publisher.start(p.pid, address, Situ.Options.validate!(opts, @publisher))

  @doc """
  Publishes a stream; returns it.

  #{Situ.Options.docs(Keyword.drop(Sink.schema(), [:address, :shared, :socket]))}
  """
  @spec publish(Situ.Stream.t(), String.t() | Publisher.t(), keyword()) :: Situ.Stream.t()
  def publish(stream, %Publisher{} = shared, opts) do
    Publisher.expect(shared)
    Situ.via(stream, Sink, [socket: :pub, shared: shared] ++ opts)
    stream
  end

  def publish(stream, address, opts), do: sink(stream, :pub, address, opts)

  @doc "Pushes a stream to the peers that pull; returns it. Options as `publish/3`, without a topic."
  @spec push(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def push(stream, address, opts \\ []), do: sink(stream, :push, address, opts)

  @doc """
  A source of the messages of a topic.

  #{Situ.Options.docs(Keyword.drop(Source.schema(), [:address, :socket]))}
  """
  @spec subscribe(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def subscribe(p, address, opts), do: source(p, :sub, address, opts)

  @doc "A source of what is pushed to it. Options as `subscribe/3`, without a topic."
  @spec pull(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def pull(p, address, opts \\ []), do: source(p, :pull, address, opts)

  defp sink(stream, socket, address, opts) do
    Situ.via(stream, Sink, [socket: socket, address: address] ++ opts)
    stream
  end

  defp source(p, socket, address, opts) do
    outputs = [out: opts[:type] || :any]
    Situ.source(p, Source, [socket: socket, address: address, outputs: outputs] ++ opts)
  end

  @doc "The name that all bridges have for their way out: `publish/3` with a `topic:`, else `push/3`."
  @spec sink(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, address, opts \\ []) do
    if opts[:topic], do: publish(stream, address, opts), else: push(stream, address, opts)
  end

  @doc "The name that all bridges have for their way in: `subscribe/3` with a `topic:`, else `pull/3`."
  @spec source(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def source(p, address, opts \\ []) do
    if opts[:topic], do: subscribe(p, address, opts), else: pull(p, address, opts)
  end
end

defmodule Situ.Bridge.Ros do
  @moduledoc """
  Live topics, services and parameters of ROS 1, in plain Elixir: no ROS is needed on this machine.

      scans = Situ.Bridge.Ros.subscribe(p, "/scan", master: "http://robot:11311")
      Situ.Bridge.Ros.publish(pictures, "/camera/image_raw")
      {:ok, %{"sum" => 5}} = Situ.Bridge.Ros.call("/add", definition, %{"a" => 2, "b" => 3})

  Messages of any type come by the definition that their publisher sends; standard ones are Situ's types
  (`Situ.Bridge.Ros.Standard`), others are maps with string keys, times in nanoseconds. The stamp of a header becomes
  the originating time, also a simulated one, and the other way round. Each stream is a node of its own.

  A master or a publisher that is not there yet is waited for, one that was restarted is found again. A subscriber that
  is too slow loses messages, counted, beyond `high_water_mark:`. Messages that cannot be read, or whose times do not
  increase, are left out and counted (`Situ.Pipeline.info/1`). ROS 1 has neither encryption nor authentication: with a
  master on this machine a node listens on 127.0.0.1 only, else everywhere.
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
  A source of a topic's messages.

  #{Situ.Options.docs(Keyword.delete(Source.schema(), :topic))}
  """
  @spec subscribe(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def subscribe(p, topic, opts \\ []),
    do: Situ.source(p, Source, [topic: topic, outputs: [out: opts[:type] || :any]] ++ opts)

  @doc """
  Calls a service: a message of its request type, `{:ok, message}` of its response type. `definition` is the text of its
  `.srv`. Option `timeout:` (5,000 ms), and those below. Errors: `:ros_unreachable`, `:ros_refused` (there is no such
  service, its type is another, or it says no), `:bad_definition`, `:not_writable`.

  #{Situ.Options.docs(Address.options())}
  """
  @spec call(String.t(), String.t(), map(), keyword()) :: {:ok, map()} | {:error, Error.t()}
  defdelegate call(service, definition, request, opts \\ []), to: Service

  @doc """
  Offers a service: `fun` gets a request and answers `{:ok, response}` or `{:error, text}`; in a process of its own for
  each caller. Ends with `stop/1`, and with the calling process. `type` is that of the `.srv` (`"std_srvs/SetBool"`).
  Options as `call/4`.
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

  @doc "Ends a service."
  @spec stop(pid()) :: :ok
  defdelegate stop(server), to: Service

  @doc "A parameter of the master's: numbers, booleans, texts, lists, maps. Errors as `call/4`. Options: `master:`."
  @spec get_param(String.t(), keyword()) :: {:ok, term()} | {:error, Error.t()}
  def get_param(name, opts \\ []), do: master("getParam", [Address.whole(name)], opts)

  @doc "Sets a parameter."
  @spec set_param(String.t(), term(), keyword()) :: :ok | {:error, Error.t()}
  def set_param(name, value, opts \\ []) do
    with {:ok, _} <- master("setParam", [Address.whole(name), value], opts), do: :ok
  end

  @doc "The topics that somebody publishes: `{topic, type}`."
  @spec topics(keyword()) :: {:ok, [{String.t(), String.t()}]} | {:error, Error.t()}
  def topics(opts \\ []) do
    with {:ok, list} <- master("getPublishedTopics", [""], opts),
         do: {:ok, for([topic, type] <- list, do: {topic, type})}
  end

  defp master(method, arguments, opts) do
    address = Address.new(opts)
    Registrar.call(address, method, [address.node | arguments])
  end

  @doc "The name that all bridges have for their way out: `publish/3`."
  @spec sink(Situ.Stream.t(), String.t(), keyword()) :: Situ.Stream.t()
  def sink(stream, topic, opts \\ []), do: publish(stream, topic, opts)

  @doc "The name that all bridges have for their way in: `subscribe/3`."
  @spec source(Situ.Pipeline.t(), String.t(), keyword()) :: Situ.Stream.t()
  def source(p, topic, opts \\ []), do: subscribe(p, topic, opts)
end

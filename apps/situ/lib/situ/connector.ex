defmodule Situ.Connector do
  @moduledoc """
  Carries a stream from one pipeline into another, independent pipeline.

  The two pipelines share nothing but the connector: each has its own clock, life cycle and errors. In the target
  pipeline, the connector is an infinite source. Demand passes through it, so a slow target makes the sender wait,
  unless the sender's policy drops messages. At most `window:` messages (default 1,000) are in flight. If there are
  several targets, every target receives every message. Messages sent while no target is running are lost.

      iex> connector = Situ.Connector.new("numbers")
      iex> me = self()
      iex> {:ok, target} = Situ.Pipeline.start(fn p ->
      ...>   p |> Situ.Connector.receive(connector) |> Situ.each(&send(me, {:got, &1}))
      ...> end, [])
      iex> :ok = Situ.Connector.await_open(connector, :infinity)
      iex> {:ok, _} = Situ.Pipeline.run(fn p ->
      ...>   p |> Situ.from_enumerable([42], every: 1) |> Situ.Connector.send(connector)
      ...> end)
      iex> receive do {:got, n} -> n end
      42
      iex> {:ok, _report} = Situ.Pipeline.stop(target)
      iex> :closed
      :closed

  With `as: :data` (default), the target emits the data as a new message with the same originating time. With
  `as: :message`, it emits the complete `Situ.Message` as data. With `as: :envelope`, it keeps the times and the
  sequence id.
  """
  alias Situ.{Argument, Stream}

  @enforce_keys [:name, :ref]
  defstruct [:name, :ref]

  @type t :: %__MODULE__{name: String.t(), ref: reference()}
  @registry __MODULE__.Ends

  @doc "Creates a connector. `name` is the default name of its two components in their pipelines."
  @spec new(String.t()) :: t()
  def new(name) when is_binary(name), do: %__MODULE__{name: name, ref: make_ref()}

  @doc "Returns the stream on the receiving side. Options: `as:`, `window:`, `type:` and `Situ.Graph.Placement`."
  @spec receive(Situ.Pipeline.t(), t(), keyword()) :: Stream.t()
  def receive(p, connector, opts \\ [])

  def receive(%Situ.Graph.Handle{} = p, %__MODULE__{} = connector, opts) do
    {type, opts} = Keyword.pop(opts, :type, :any)
    opts = Keyword.put_new(opts, :name, connector.name)
    own = [connector: connector, outputs: [out: type]]
    p |> Situ.Pipeline.add(Situ.Connector.Receiver, own ++ opts) |> Situ.Node.output(:out)
  end

  def receive(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :handle, "Situ.Connector.receive(p, connector)")

  @doc "Sends a stream into the connector. Options: `policy:` and the options of `Situ.Graph.Placement`."
  @spec send(Stream.t(), t(), keyword()) :: :ok
  def send(stream, connector, opts \\ [])

  def send(%Stream{} = stream, %__MODULE__{} = connector, opts) do
    opts = [connector: connector] ++ Keyword.put_new(opts, :name, connector.name)
    node = Situ.Pipeline.add(stream.pipeline, Situ.Connector.Sender, opts)
    Situ.Pipeline.connect(stream, node, :in)
  end

  def send(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.Connector.send(stream, connector)")

  @doc "Waits until a receiving pipeline is running."
  @spec await_open(t(), timeout()) :: :ok | {:error, Situ.Error.t()}
  def await_open(%__MODULE__{} = connector, timeout) do
    {:ok, _} = Registry.register(@registry, {:waiting, connector.ref}, nil)
    ref = connector.ref

    result =
      case Registry.lookup(@registry, ref) do
        [_ | _] -> :ok
        [] -> await_receiver(ref, timeout)
      end

    Registry.unregister(@registry, {:waiting, ref})
    result
  end

  defp await_receiver(ref, timeout) do
    receive do
      {:situ_connector_open, ^ref} -> :ok
    after
      timeout -> {:error, Situ.Error.new(:timeout, "no pipeline is receiving from the connector")}
    end
  end

  @doc false
  # Registers the receiving side, notifies the processes in `await_open/2`, and returns the current sending sides.
  def announce_receiver(%__MODULE__{ref: ref}) do
    {:ok, _} = Registry.register(@registry, ref, nil)

    for {pid, _} <- Registry.lookup(@registry, {:waiting, ref}),
        do: Kernel.send(pid, {:situ_connector_open, ref})

    for {pid, _} <- Registry.lookup(@registry, {:out, ref}), do: pid
  end

  @doc false
  # Registers the sending side, and offers it to the current receiving sides, which it returns.
  def announce_sender(%__MODULE__{ref: ref}) do
    {:ok, _} = Registry.register(@registry, {:out, ref}, nil)

    for {pid, _} <- Registry.lookup(@registry, ref) do
      Kernel.send(pid, {:situ_connector_offer, self()})
      pid
    end
  end

  @doc false
  # Injects messages directly, regardless of demand.
  def deliver_messages(%__MODULE__{ref: ref}, messages) do
    for {pid, _} <- Registry.lookup(@registry, ref),
        do: Kernel.send(pid, {:situ_connector, ref, messages})

    :ok
  end

  @doc false
  def registry_spec, do: {Registry, keys: :duplicate, name: @registry}
end

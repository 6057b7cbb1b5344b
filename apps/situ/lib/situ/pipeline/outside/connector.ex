defmodule Situ.Connector do
  @moduledoc """
  Carries a stream from one pipeline into another that runs on its own.

  The two pipelines share nothing but the connector: each has its own clock, life cycle and errors. The target sees a push
  source that is infinite; what arrives while the target does not run is lost.

      iex> connector = Situ.Connector.new("numbers")
      iex> me = self()
      iex> {:ok, target} = Situ.Pipeline.start(fn p ->
      ...>   p |> Situ.Connector.receive(connector) |> Situ.each(&send(me, {:got, &1}))
      ...> end, [])
      iex> :ok = Situ.Connector.await_open(connector, :infinity)
      iex> {:ok, _} = Situ.Pipeline.run(fn p ->
      ...>   p |> Situ.source(Situ.Connector.Once, data: 42) |> Situ.Connector.send(connector)
      ...> end)
      iex> receive do {:got, n} -> n end
      42
      iex> {:ok, _report} = Situ.Pipeline.stop(target)
      iex> :closed
      :closed

  `as: :data` (default) posts the data anew at the same originating time, `as: :message` posts the whole `Situ.Message` as
  data, `as: :envelope` keeps times and sequence id.
  """
  alias Situ.Stream

  @enforce_keys [:name, :ref]
  defstruct [:name, :ref]

  @type t :: %__MODULE__{name: String.t(), ref: reference()}
  @registry __MODULE__.Ends

  @doc "A connector; `name` is what its two ends are called in their pipelines."
  @spec new(String.t()) :: t()
  def new(name) when is_binary(name), do: %__MODULE__{name: name, ref: make_ref()}

  @doc "The stream on the receiving side. Options: `as:`, `type:`, and those of `Situ.Graph.Placement`."
  @spec receive(Situ.Pipeline.t(), t(), keyword()) :: Stream.t()
  def receive(p, %__MODULE__{} = connector, opts \\ []) do
    {type, opts} = Keyword.pop(opts, :type, :any)
    opts = Keyword.put_new(opts, :name, connector.name)
    own = [connector: connector, outputs: [out: type]]
    p |> Situ.Pipeline.add(Situ.Connector.In, own ++ opts) |> Situ.Node.output(:out)
  end

  @doc "Sends a stream into the connector. Options: `policy:` and those of `Situ.Graph.Placement`."
  @spec send(Stream.t(), t(), keyword()) :: :ok
  def send(%Stream{} = stream, %__MODULE__{} = connector, opts \\ []) do
    opts = [connector: connector] ++ Keyword.put_new(opts, :name, connector.name)
    node = Situ.Pipeline.add(stream.pipeline, Situ.Connector.Out, opts)
    Situ.Pipeline.connect(stream, node, :in)
  end

  @doc "Waits until a receiving side runs."
  @spec await_open(t(), timeout()) :: :ok | {:error, Situ.Error.t()}
  def await_open(%__MODULE__{} = connector, timeout) do
    {:ok, _} = Registry.register(@registry, {:waiting, connector.ref}, nil)
    ref = connector.ref

    result =
      case Registry.lookup(@registry, ref) do
        [_ | _] -> :ok
        [] -> wait(ref, timeout)
      end

    Registry.unregister(@registry, {:waiting, ref})
    result
  end

  defp wait(ref, timeout) do
    receive do
      {:situ_connector_open, ^ref} -> :ok
    after
      timeout -> {:error, Situ.Error.new(:timeout, "no pipeline receives from the connector")}
    end
  end

  @doc false
  def open(%__MODULE__{ref: ref}) do
    {:ok, _} = Registry.register(@registry, ref, nil)

    for {pid, _} <- Registry.lookup(@registry, {:waiting, ref}),
        do: Kernel.send(pid, {:situ_connector_open, ref})

    :ok
  end

  @doc false
  def deliver(%__MODULE__{ref: ref}, messages) do
    for {pid, _} <- Registry.lookup(@registry, ref),
        do: Kernel.send(pid, {:situ_connector, ref, messages})

    :ok
  end

  @doc false
  def registry, do: {Registry, keys: :duplicate, name: @registry}
end

defmodule Situ.Connector.In do
  @moduledoc false
  # The receiving side: a push source without an end.
  use Situ.Component,
    outputs: [out: :any],
    options: [
      connector: [type: {:struct, Situ.Connector}, required: true],
      as: [type: {:in, [:data, :message, :envelope]}, default: :data]
    ]

  @impl true
  def init(opts), do: {:ok, Map.new(opts)}

  @impl true
  def handle_start(_context, state) do
    Situ.Connector.open(state.connector)
    {[{:complete, :infinity}], state}
  end

  @impl true
  def handle_info({:situ_connector, _ref, messages}, _context, state),
    do: {actions(messages, state.as), state}

  def handle_info(_other, _context, state), do: {[], state}

  defp actions(messages, :envelope), do: [{:out, messages}]
  defp actions(messages, :data), do: for(m <- messages, do: {:out, m.originating_time, m.data})
  defp actions(messages, :message), do: for(m <- messages, do: {:out, m.originating_time, m})
end

defmodule Situ.Connector.Out do
  @moduledoc false
  # The sending side.
  use Situ.Component,
    inputs: [in: :any],
    options: [connector: [type: {:struct, Situ.Connector}, required: true]]

  @impl true
  def handle_message(:in, message, _context, opts) do
    Situ.Connector.deliver(opts[:connector], [message])
    {[], opts}
  end

  @impl true
  def handle_messages(:in, messages, _context, opts) do
    Situ.Connector.deliver(opts[:connector], messages)
    {[], opts}
  end
end

defmodule Situ.Connector.Once do
  @moduledoc false
  # One message at the start, for the connector's own example.
  use Situ.Component, outputs: [out: :any], options: [data: [type: :any, required: true]]

  @impl true
  def handle_start(context, opts),
    do: {[{:out, context.start_time, opts[:data]}, {:complete, context.start_time}], opts}
end

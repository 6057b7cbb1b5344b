defmodule Situ.Connector do
  @moduledoc """
  Carries a stream from one pipeline into another that runs on its own.

  The two pipelines share nothing but the connector: each has its own clock, life cycle and errors. The target sees an
  infinite source. Its demand goes through the connector: a target that is slow makes the sender wait (at most
  `window:` messages are under way, 1,000 if not said otherwise), unless the sender's policy drops; several targets
  all get all. Messages sent while no target runs are lost.

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

  `as: :data` (default) posts the data as a new message at the same originating time, `as: :message` posts the whole
  `Situ.Message` as data, `as: :envelope` keeps times and sequence id.
  """
  alias Situ.{Argument, Stream}

  @enforce_keys [:name, :ref]
  defstruct [:name, :ref]

  @type t :: %__MODULE__{name: String.t(), ref: reference()}
  @registry __MODULE__.Ends

  @doc "A connector; `name` is what its two ends are called in their pipelines."
  @spec new(String.t()) :: t()
  def new(name) when is_binary(name), do: %__MODULE__{name: name, ref: make_ref()}

  @doc "The stream on the receiving side. Options: `as:`, `window:`, `type:`, and those of `Situ.Graph.Placement`."
  @spec receive(Situ.Pipeline.t(), t(), keyword()) :: Stream.t()
  def receive(p, connector, opts \\ [])

  def receive(%Situ.Graph.Handle{} = p, %__MODULE__{} = connector, opts) do
    {type, opts} = Keyword.pop(opts, :type, :any)
    opts = Keyword.put_new(opts, :name, connector.name)
    own = [connector: connector, outputs: [out: type]]
    p |> Situ.Pipeline.add(Situ.Connector.In, own ++ opts) |> Situ.Node.output(:out)
  end

  def receive(other, _arg2, _arg3),
    do: Argument.refuse!(other, :handle, "Situ.Connector.receive(p, connector)")

  @doc "Sends a stream into the connector. Options: `policy:` and those of `Situ.Graph.Placement`."
  @spec send(Stream.t(), t(), keyword()) :: :ok
  def send(stream, connector, opts \\ [])

  def send(%Stream{} = stream, %__MODULE__{} = connector, opts) do
    opts = [connector: connector] ++ Keyword.put_new(opts, :name, connector.name)
    node = Situ.Pipeline.add(stream.pipeline, Situ.Connector.Out, opts)
    Situ.Pipeline.connect(stream, node, :in)
  end

  def send(other, _arg2, _arg3),
    do: Argument.refuse!(other, :stream, "Situ.Connector.send(stream, connector)")

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
  # The receiving side runs: tells those who wait, and answers the sending sides there are.
  def open(%__MODULE__{ref: ref}) do
    {:ok, _} = Registry.register(@registry, ref, nil)

    for {pid, _} <- Registry.lookup(@registry, {:waiting, ref}),
        do: Kernel.send(pid, {:situ_connector_open, ref})

    for {pid, _} <- Registry.lookup(@registry, {:out, ref}), do: pid
  end

  @doc false
  # The sending side runs: the receiving sides there are learn of it.
  def offer(%__MODULE__{ref: ref}) do
    {:ok, _} = Registry.register(@registry, {:out, ref}, nil)

    for {pid, _} <- Registry.lookup(@registry, ref) do
      Kernel.send(pid, {:situ_connector_offer, self()})
      pid
    end
  end

  @doc false
  # Messages put in by hand, whatever was asked for.
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
  # The receiving side: a consumer, in GenStage's protocol, of every sending side; a source without an end.
  use Situ.Component,
    outputs: [out: :any],
    options: [
      connector: [type: {:struct, Situ.Connector}, required: true],
      as: [type: {:in, [:data, :message, :envelope]}, default: :data],
      window: [type: :pos_integer, default: 1_000]
    ]

  @impl true
  def init(opts), do: {:ok, opts |> Map.new() |> Map.put(:subs, %{})}

  @impl true
  def handle_start(_context, state) do
    senders = Situ.Connector.open(state.connector)
    {[{:complete, :infinity}], Enum.reduce(senders, state, &subscribe/2)}
  end

  # Both sides may have found each other.
  defp subscribe(pid, state) do
    if Enum.any?(state.subs, fn {_, sub} -> sub.pid == pid end) do
      state
    else
      ref = Process.monitor(pid)
      Kernel.send(pid, {:"$gen_producer", {self(), ref}, {:subscribe, nil, []}})
      Kernel.send(pid, {:"$gen_producer", {self(), ref}, {:ask, state.window}})
      Kernel.send(pid, {:situ_connector_joined, self()})
      put_in(state.subs[ref], %{pid: pid, taken: 0})
    end
  end

  # There is room: what was taken is asked for again.
  @impl true
  def handle_demand(_n, _context, state) do
    {[], %{state | subs: Map.new(state.subs, fn {ref, sub} -> {ref, ask(ref, sub, state)} end)}}
  end

  defp ask(ref, %{taken: taken} = sub, %{window: window})
       when taken > 0 and taken >= div(window, 2) do
    Kernel.send(sub.pid, {:"$gen_producer", {self(), ref}, {:ask, taken}})
    %{sub | taken: 0}
  end

  defp ask(_ref, sub, _state), do: sub

  @impl true
  def handle_info({:"$gen_consumer", {_pid, ref}, {:cancel, _reason}}, _context, state)
      when is_map_key(state.subs, ref) do
    Process.demonitor(ref, [:flush])
    {[], %{state | subs: Map.delete(state.subs, ref)}}
  end

  def handle_info({:"$gen_consumer", {_pid, ref}, messages}, _context, state)
      when is_map_key(state.subs, ref),
      do:
        {actions(messages, state.as), update_in(state.subs[ref].taken, &(&1 + length(messages)))}

  def handle_info({:DOWN, ref, :process, _pid, _reason}, _context, state),
    do: {[], %{state | subs: Map.delete(state.subs, ref)}}

  def handle_info({:situ_connector_offer, pid}, _context, state), do: {[], subscribe(pid, state)}

  def handle_info({:situ_connector, _ref, messages}, _context, state),
    do: {actions(messages, state.as), state}

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_stop(_final, _context, state), do: {[], cancel(state)}

  @impl true
  def terminate(_reason, state), do: cancel(state)

  defp cancel(state) do
    for {ref, sub} <- state.subs,
        do: Kernel.send(sub.pid, {:"$gen_producer", {self(), ref}, {:cancel, :normal}})

    %{state | subs: %{}}
  end

  defp actions(messages, :envelope), do: [{:out, messages}]
  defp actions(messages, :data), do: for(m <- messages, do: {:out, m.originating_time, m.data})
  defp actions(messages, :message), do: for(m <- messages, do: {:out, m.originating_time, m})
end

defmodule Situ.Connector.Out do
  @moduledoc false
  # The sending side: its output has consumers outside the pipeline. Nothing goes out before those that run have
  # subscribed.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [connector: [type: {:struct, Situ.Connector}, required: true]]

  @impl true
  def init(opts), do: {:ok, %{connector: opts[:connector], awaited: %{}}}

  @impl true
  def handle_start(_context, state) do
    awaited = Map.new(Situ.Connector.offer(state.connector), &{&1, Process.monitor(&1)})
    {if(awaited == %{}, do: [], else: [{:demand, :accumulate}]), %{state | awaited: awaited}}
  end

  @impl true
  def handle_info({:situ_connector_joined, pid}, _context, state), do: arrived(pid, state)
  def handle_info({:DOWN, _, :process, pid, _}, _context, state), do: arrived(pid, state)
  def handle_info(_other, _context, state), do: {[], state}

  defp arrived(pid, state) do
    case Map.pop(state.awaited, pid) do
      {nil, _} ->
        {[], state}

      {monitor, awaited} ->
        Process.demonitor(monitor, [:flush])
        {if(awaited == %{}, do: [{:demand, :forward}], else: []), %{state | awaited: awaited}}
    end
  end

  @impl true
  def handle_message(:in, message, _context, state), do: {[{:out, message}], state}

  @impl true
  def handle_messages(:in, messages, _context, state), do: {[{:out, messages}], state}
end

defmodule Situ.Connector.Once do
  @moduledoc false
  # One message at the start, for the connector's own example.
  use Situ.Component, outputs: [out: :any], options: [data: [type: :any, required: true]]

  @impl true
  def handle_start(context, opts),
    do: {[{:out, context.start_time, opts[:data]}, {:complete, context.start_time}], opts}
end

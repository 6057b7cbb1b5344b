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
      ...>   p |> Situ.source(Situ.Connector.Once, data: 42) |> Situ.Connector.send(connector)
      ...> end)
      iex> receive do {:got, n} -> n end
      42
      iex> {:ok, _report} = Situ.Pipeline.stop(target)
      iex> :closed
      :closed

  With `as: :data` (default), the target emits the data as a new message with the same originating time. With
  `as: :message`, it emits the whole `Situ.Message` as data. With `as: :envelope`, it keeps the times and the sequence
  id.
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
    p |> Situ.Pipeline.add(Situ.Connector.In, own ++ opts) |> Situ.Node.output(:out)
  end

  def receive(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :handle, "Situ.Connector.receive(p, connector)")

  @doc "Sends a stream into the connector. Options: `policy:` and the options of `Situ.Graph.Placement`."
  @spec send(Stream.t(), t(), keyword()) :: :ok
  def send(stream, connector, opts \\ [])

  def send(%Stream{} = stream, %__MODULE__{} = connector, opts) do
    opts = [connector: connector] ++ Keyword.put_new(opts, :name, connector.name)
    node = Situ.Pipeline.add(stream.pipeline, Situ.Connector.Out, opts)
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

defmodule Situ.Connector.In do
  @moduledoc false
  # The receiving side consumes from every sending side with GenStage's protocol; it is a source without an end.
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
    senders = Situ.Connector.announce_receiver(state.connector)
    {[{:complete, :infinity}], Enum.reduce(senders, state, &subscribe_sender/2)}
  end

  # Both sides may have discovered each other at the same time.
  defp subscribe_sender(pid, state) do
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

  # The pipeline has room, so request as many messages as were received.
  @impl true
  def handle_demand(_n, _context, state) do
    {[],
     %{
       state
       | subs: Map.new(state.subs, fn {ref, sub} -> {ref, request_more(ref, sub, state)} end)
     }}
  end

  defp request_more(ref, %{taken: taken} = sub, %{window: window})
       when taken > 0 and taken >= div(window, 2) do
    Kernel.send(sub.pid, {:"$gen_producer", {self(), ref}, {:ask, taken}})
    %{sub | taken: 0}
  end

  defp request_more(_ref, sub, _state), do: sub

  @impl true
  def handle_info({:"$gen_consumer", {_pid, ref}, {:cancel, _reason}}, _context, state)
      when is_map_key(state.subs, ref) do
    Process.demonitor(ref, [:flush])
    {[], %{state | subs: Map.delete(state.subs, ref)}}
  end

  def handle_info({:"$gen_consumer", {_pid, ref}, messages}, _context, state)
      when is_map_key(state.subs, ref),
      do:
        {message_actions(messages, state.as),
         update_in(state.subs[ref].taken, &(&1 + length(messages)))}

  def handle_info({:DOWN, ref, :process, _pid, _reason}, _context, state),
    do: {[], %{state | subs: Map.delete(state.subs, ref)}}

  def handle_info({:situ_connector_offer, pid}, _context, state),
    do: {[], subscribe_sender(pid, state)}

  def handle_info({:situ_connector, _ref, messages}, _context, state),
    do: {message_actions(messages, state.as), state}

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_stop(_final, _context, state), do: {[], cancel_subscriptions(state)}

  @impl true
  def terminate(_reason, state), do: cancel_subscriptions(state)

  defp cancel_subscriptions(state) do
    for {ref, sub} <- state.subs,
        do: Kernel.send(sub.pid, {:"$gen_producer", {self(), ref}, {:cancel, :normal}})

    %{state | subs: %{}}
  end

  defp message_actions(messages, :envelope), do: [{:out, messages}]

  defp message_actions(messages, :data),
    do: for(m <- messages, do: {:out, m.originating_time, m.data})

  defp message_actions(messages, :message),
    do: for(m <- messages, do: {:out, m.originating_time, m})
end

defmodule Situ.Connector.Out do
  @moduledoc false
  # The sending side: its output has consumers outside the pipeline. It holds its messages back until every running
  # receiving side has subscribed.
  use Situ.Component,
    inputs: [in: :any],
    outputs: [out: :any],
    options: [connector: [type: {:struct, Situ.Connector}, required: true]]

  @impl true
  def init(opts), do: {:ok, %{connector: opts[:connector], awaited: %{}}}

  @impl true
  def handle_start(_context, state) do
    awaited = Map.new(Situ.Connector.announce_sender(state.connector), &{&1, Process.monitor(&1)})
    {if(awaited == %{}, do: [], else: [{:demand, :accumulate}]), %{state | awaited: awaited}}
  end

  @impl true
  def handle_info({:situ_connector_joined, pid}, _context, state), do: remove_awaited(pid, state)
  def handle_info({:DOWN, _, :process, pid, _}, _context, state), do: remove_awaited(pid, state)
  def handle_info(_other, _context, state), do: {[], state}

  defp remove_awaited(pid, state) do
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
  # Emits one message at the start; used by the example of `Situ.Connector`.
  use Situ.Component, outputs: [out: :any], options: [data: [type: :any, required: true]]

  @impl true
  def handle_start(context, opts),
    do: {[{:out, context.start_time, opts[:data]}, {:complete, context.start_time}], opts}
end

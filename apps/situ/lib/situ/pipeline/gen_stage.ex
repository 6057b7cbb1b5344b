defmodule Situ.GenStage do
  @moduledoc """
  GenStage and Flow as neighbours: Situ's processes speak GenStage's message protocol, so a real GenStage consumer can
  subscribe to any output and a real GenStage producer can be a source. GenStage itself is not needed.

  ## A GenStage consumer behind an output

      {:ok, {pid, opts}} = Situ.GenStage.subscription(pipeline, "Lobby.Speaking")
      GenStage.sync_subscribe(consumer, [to: pid, max_demand: 500] ++ opts)

  It receives `%Situ.Message{}` structs as events. An output waits for all its subscribers: a consumer that stops asking holds
  the pipeline up, which is what back-pressure means (`Situ.tap/3` never does). When the output ends the subscription is
  cancelled with `{:shutdown, {:closed, time}}`.

  ## A GenStage producer as a source

      stream = Situ.GenStage.from(p, producer, type: :integer)

  Events that are `%Situ.Message{}` keep their originating times; other events get the pipeline's clock, at least 1 ns after
  the one before. When the producer cancels or dies the stream completes.

  ## The messages

  | from | to | message |
  |---|---|---|
  | consumer | producer | `{:"$gen_producer", {consumer_pid, tag}, {:subscribe, current, opts}}`; `opts[:output]` names the output |
  | consumer | producer | `{:"$gen_producer", {consumer_pid, tag}, {:ask, count}}` |
  | consumer | producer | `{:"$gen_producer", {consumer_pid, tag}, {:cancel, reason}}` |
  | producer | consumer | `{:"$gen_consumer", {producer_pid, tag}, [event]}`, never more than asked for |
  | producer | consumer | `{:"$gen_consumer", {producer_pid, tag}, {:cancel, reason}}`, also in answer to a cancel |

  `tag` is a term the consumer chooses (GenStage: its monitor's reference); it names the subscription in both directions. Both
  sides monitor each other. Within a pipeline tags are the edge's number and the subscription is made at the start.

      iex> {:ok, p} = Situ.Pipeline.start(fn p ->
      ...>   p |> Situ.Connector.receive(Situ.Connector.new("x")) |> Situ.map(& &1, name: "Same")
      ...> end, [])
      iex> {:ok, {pid, opts}} = Situ.GenStage.subscription(p, "Same")
      iex> {is_pid(pid), opts}
      {true, [output: :out]}
      iex> {:ok, _report} = Situ.Pipeline.stop(p)
      iex> {:error, error} = Situ.GenStage.subscription(p, "Same")
      iex> error.code
      :not_running
  """
  alias Situ.Pipeline.Client

  @doc "Where to subscribe for a stream: the process and the options that name the output. The pipeline must be running."
  @spec subscription(Situ.Pipeline.target(), Situ.Stream.t() | String.t()) ::
          {:ok, {pid(), keyword()}} | {:error, Situ.Error.t()}
  def subscription(p, %Situ.Stream{} = stream),
    do: Client.call(p, {:subscription, {stream.node, stream.output}})

  def subscription(p, name) when is_binary(name), do: Client.call(p, {:subscription, name})

  @doc """
  The events of a GenStage producer (pid or name) as a stream.

  Options: `type:`, `subscribe:` (options for the producer, such as `partition:`), and the common ones of
  `Situ.Pipeline.add/4`.
  """
  @spec from(Situ.Pipeline.t(), GenServer.server(), keyword()) :: Situ.Stream.t()
  def from(%Situ.Graph.Handle{} = p, producer, opts \\ []) do
    {own, common} = Keyword.split(opts, [:type, :subscribe])

    common =
      Keyword.merge([name: "GenStage", outputs: [out: Keyword.get(own, :type, :any)]], common)

    options = [producer: producer, subscribe: Keyword.get(own, :subscribe, [])]
    p |> Situ.Pipeline.add(Situ.GenStage.Source, options, common) |> Situ.Node.output(:out)
  end
end

defmodule Situ.GenStage.Source do
  @moduledoc false
  # The consumer's side of the protocol as a pull source: demand from downstream is asked of the producer.
  use Situ.Component,
    outputs: [out: :any],
    options: [producer: [type: :any, required: true], subscribe: [type: :keyword, default: []]]

  alias Situ.{Error, Message}

  @impl true
  def init(opts) do
    {:ok,
     %{
       producer: opts[:producer],
       subscribe: opts[:subscribe],
       pid: nil,
       ref: nil,
       asked: 0,
       last: nil
     }}
  end

  @impl true
  def handle_start(_context, state) do
    case GenServer.whereis(state.producer) do
      nil ->
        raise Error.new(:no_producer, "no process #{inspect(state.producer)} to subscribe to")

      pid ->
        {[], subscribe(%{state | pid: pid, ref: Process.monitor(pid)})}
    end
  end

  @impl true
  def handle_demand(_n, _context, %{ref: nil} = state), do: {[], state}

  def handle_demand(n, _context, state) do
    more = n - state.asked
    if more > 0, do: send(state.pid, {:"$gen_producer", {self(), state.ref}, {:ask, more}})
    {[], %{state | asked: max(state.asked, n)}}
  end

  @impl true
  def handle_info(
        {:"$gen_consumer", {_pid, ref}, {:cancel, _reason}},
        context,
        %{ref: ref} = state
      ),
      do: ended(context, state)

  def handle_info({:"$gen_consumer", {_pid, ref}, events}, context, %{ref: ref} = state) do
    {actions, last} = Enum.map_reduce(events, state.last, &post(&1, &2, context.now))
    {actions, %{state | last: last, asked: max(state.asked - length(events), 0)}}
  end

  def handle_info({:DOWN, ref, :process, _pid, _reason}, context, %{ref: ref} = state),
    do: ended(context, state)

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_stop(_final, _context, state), do: {[], cancel(state)}

  @impl true
  def terminate(_reason, state), do: cancel(state)

  defp subscribe(state) do
    send(state.pid, {:"$gen_producer", {self(), state.ref}, {:subscribe, nil, state.subscribe}})
    state
  end

  defp cancel(%{ref: nil} = state), do: state

  defp cancel(state) do
    send(state.pid, {:"$gen_producer", {self(), state.ref}, {:cancel, :normal}})
    Process.demonitor(state.ref, [:flush])
    %{state | ref: nil}
  end

  defp ended(context, state) do
    Process.demonitor(state.ref, [:flush])
    {[{:complete, state.last || context.now}], %{state | ref: nil}}
  end

  defp post(%Message{} = message, _last, _now),
    do: {{:out, message.originating_time, message.data}, message.originating_time}

  defp post(data, last, now) do
    time = if last == nil, do: now, else: max(now, last + 1)
    {{:out, time, data}, time}
  end
end

defmodule Situ.GenStage do
  @moduledoc """
  Connects GenStage, Flow and Broadway to pipelines. Situ's processes use GenStage's message protocol, so a GenStage
  consumer can subscribe to any output, and a GenStage producer can be a source. Situ does not depend on GenStage.

  ## A GenStage consumer on an output

      {:ok, {pid, opts}} = Situ.GenStage.subscription(pipeline, "Lobby.Speaking")
      GenStage.sync_subscribe(consumer, [to: pid, max_demand: 500] ++ opts)

  The consumer receives `%Situ.Message{}` structs as events. An output waits for all its subscribers, so a consumer
  that stops requesting events stalls the pipeline (a tap from `Situ.attach_tap/3` never does). When the output ends,
  the subscription is canceled with `{:shutdown, {:closed, time}}`. When its component fails, the subscription is
  canceled with the `Situ.Error`, so that a `:transient` consumer fails as well.

  A pipeline starts emitting as soon as it is started, and later subscribers miss the messages emitted before.
  `accumulate/2` holds a stream back until `GenStage.demand(pid, :forward)`, which `Flow.from_stages/2` calls
  automatically.

  Every consumer receives every message. `dispatch/3` shares the messages among consumers, as GenStage's dispatchers
  do.

  ## A GenStage producer as a source

      stream = Situ.GenStage.from(p, producer, type: :integer)

  Events that are `%Situ.Message{}` structs keep their originating times. Other events get the time of the pipeline's
  clock, at least 1 ns after the event before. When the producer ends normally (`:normal`, `:shutdown`,
  `{:shutdown, _}`), the stream completes. Any other reason is a `:producer_failed` error of the component, which
  fails the pipeline unless its `on_error:` option prevents it.

  Without a producer, as in `from(p, [])`, the stream waits until a producer is assigned with
  `Flow.into_stages(flow, [pid])` or `GenStage.sync_subscribe(pid, to: producer)`. `subscription/2` returns this
  `pid`.

  `acknowledge/3` acknowledges the events of Broadway's producers, and of others, once the pipeline has handled them.

  ## The messages

  | from | to | message |
  |---|---|---|
  | consumer | producer | `{:"$gen_producer", {consumer_pid, tag}, {:subscribe, current, opts}}`; `opts[:output]` names the output |
  | consumer | producer | `{:"$gen_producer", {consumer_pid, tag}, {:ask, count}}` |
  | consumer | producer | `{:"$gen_producer", {consumer_pid, tag}, {:cancel, reason}}` |
  | producer | consumer | `{:"$gen_consumer", {producer_pid, tag}, [event]}`, never more than requested |
  | producer | consumer | `{:"$gen_consumer", {producer_pid, tag}, {:cancel, reason}}`, also in reply to a cancel |

  `tag` is a term that the consumer chooses (GenStage uses its monitor reference). Together with the consumer's pid it
  identifies the subscription in both directions. Both sides monitor each other. Four of GenStage's calls and casts
  are supported: `:"$estimate_buffered_count"`, `{:"$demand", mode}`, `{:"$info", message}` and, for a source,
  `{:"$subscribe", current, to, opts}`. Malformed messages are rejected and never crash the process. Within a
  pipeline, the tag is the edge's number, and the subscription is made at the start.

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

  The work of a pipeline, shared by two consumers:

      iex> {:ok, p} = Situ.Pipeline.start(fn p ->
      ...>   p |> Situ.from_enumerable(1..4, every: 1) |> Situ.GenStage.dispatch(:demand, name: "Jobs")
      ...> end, [])
      iex> {:ok, {pid, opts}} = Situ.GenStage.subscription(p, "Jobs")
      iex> for tag <- [:a, :b], request <- [{:subscribe, nil, opts}, {:ask, 3}],
      ...>   do: send(pid, {:"$gen_producer", {self(), tag}, request})
      iex> jobs = for tag <- [:a, :b] do
      ...>   receive do: ({:"$gen_consumer", {^pid, ^tag}, messages} -> length(messages))
      ...> end
      iex> Enum.all?(jobs, &(&1 in 1..3))
      true
      iex> {:ok, _report} = Situ.Pipeline.await(p)
      iex> :ok
      :ok
  """
  # See docs/adr/0011-demand-uses-genstage-messages.md and docs/adr/0166-outputs-can-have-a-dispatcher.md.
  alias Situ.Argument
  alias Situ.Pipeline.Client
  alias Situ.Ports.Dispatcher

  @typedoc "How an output shares its messages among consumers outside the pipeline, see `dispatch/3`."
  @type dispatcher :: :demand | :broadcast | {:partition, keyword()}

  @doc """
  Returns the process to subscribe to and the options that name the output. The pipeline must be running.
  """
  @spec subscription(Situ.Pipeline.target(), Situ.Stream.t() | String.t()) ::
          {:ok, {pid(), keyword()}} | {:error, Situ.Error.t()}
  def subscription(p, %Situ.Stream{} = stream),
    do: Client.call(p, {:subscription, {stream.node, stream.output}})

  def subscription(p, name) when is_binary(name), do: Client.call(p, {:subscription, name})

  @doc """
  Returns the events of GenStage producers (a pid or name, or a list of them) as a stream.

  Instead of producers, `from/3` takes a function that starts and returns them. The process of the source calls it when
  the pipeline starts, and again when the source restarts. Producers that it links to itself end with it.

  The options are `type:`, `subscribe:` and the placement options. `subscribe:` holds options for the
  producers, such as `partition:`, `selector:`, `max_demand:` (default 1,000), `min_demand:` (default half of
  `max_demand:`) and `cancel:`. With `cancel: :temporary`, a producer's failure ends only its subscription.
  """
  @spec from(Situ.Pipeline.t(), producers | (() -> producers), keyword()) :: Situ.Stream.t()
        when producers: GenServer.server() | [GenServer.server()]
  def from(p, producers, opts \\ [])

  def from(%Situ.Graph.Handle{} = p, producers, opts) do
    {type, opts} = Keyword.pop(opts, :type, :any)
    producers = if is_function(producers, 0), do: producers, else: List.wrap(producers)
    own = [producers: producers, default_name: "GenStage", outputs: [out: type]]
    p |> Situ.Pipeline.add(Situ.GenStage.Source, own ++ opts) |> Situ.Node.streams()
  end

  def from(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :handle, "Situ.GenStage.from(p, producer)")

  @doc """
  Holds the stream back until a consumer releases it with `GenStage.demand(pid, :forward)`, so that a consumer that
  subscribes after the start loses no messages. A pipeline whose sources have ended waits for the release; a pipeline
  that is stopped does not. Options: `Situ.Graph.Placement`.

      Situ.from_enumerable(p, 0..999, every: Situ.Time.ms(1)) |> Situ.GenStage.accumulate(name: "Numbers")
  """
  @spec accumulate(Situ.Stream.t(), keyword()) :: Situ.Stream.t()
  def accumulate(stream, opts \\ [])

  def accumulate(%Situ.Stream{} = stream, opts),
    do: add_outlet(stream, [default_name: "Accumulate", demand: :accumulate] ++ opts)

  def accumulate(other, _arg2),
    do: Argument.raise_invalid!(other, :stream, "Situ.GenStage.accumulate(stream)")

  @doc """
  Shares the messages of a stream among GenStage consumers outside the pipeline. `dispatcher` is one of:

    * `:demand`: each message goes to the consumer with the largest demand, and among equals to the consumer that has
      waited longest. If a consumer leaves, its unsent messages go to the others.
    * `:broadcast`: each message goes to every consumer once all have asked for it, so the slowest one sets the pace.
      A consumer that subscribes with `selector: fn message -> boolean end` receives only these messages, and the
      others do not count against its demand. A process can subscribe once.
    * `{:partition, partitions: n_or_names, hash: fun}`: each message goes to the consumer of its partition. One
      consumer subscribes to each partition, with `partition: name`. `fun` takes a message and returns
      `{message, partition}`, or `:none` to drop it. Without `hash:`, the partitions are numbered from 0, and messages
      with equal data go to the same one. The demand of all partitions counts together, so messages of a busy
      partition wait in the pipeline.

  The stream waits until consumers have subscribed and asked. A pipeline that is stopped does not wait for a consumer,
  and drops the messages that none can receive. Inputs in the pipeline that are connected to the returned stream receive
  every message. Options: `demand: :accumulate` (as `accumulate/2`), and `Situ.Graph.Placement`.

      Situ.from_enumerable(p, 0..999, every: Situ.Time.ms(1)) |> Situ.GenStage.dispatch(:demand, name: "Jobs")
  """
  @spec dispatch(Situ.Stream.t(), dispatcher(), keyword()) :: Situ.Stream.t()
  def dispatch(stream, dispatcher, opts \\ [])

  def dispatch(%Situ.Stream{} = stream, dispatcher, opts) do
    with {:error, error} <- Dispatcher.new(dispatcher), do: raise(error)
    add_outlet(stream, [default_name: "Dispatch", dispatcher: dispatcher] ++ opts)
  end

  def dispatch(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.GenStage.dispatch(stream, :demand)")

  @doc """
  Acknowledges the events of a stream from `from/3` once the messages made of them have arrived in the stream `done`, so
  that their producer delivers the others again after a crash.

      events = Situ.GenStage.from(p, producer)
      done = events |> Situ.map(& &1.data) |> Situ.each(&Shop.put_order/1)
      Situ.GenStage.acknowledge(events, done)

  For example, with a function that receives the acknowledgements:

      iex> me = self()
      iex> {:ok, _report} = Situ.Pipeline.run(fn p ->
      ...>   events = Situ.from_enumerable(p, 1..3, every: 1)
      ...>   done = Situ.filter(events, & &1 != 2)
      ...>   Situ.GenStage.acknowledge(events, done, with: &send(me, {:acknowledged, &1, &2}))
      ...> end)
      iex> drain = fn drain, good, bad ->
      ...>   receive do
      ...>     {:acknowledged, more, worse} -> drain.(drain, good ++ more, bad ++ worse)
      ...>   after
      ...>     0 -> {good, bad}
      ...>   end
      ...> end
      iex> drain.(drain, [], [])
      {[1, 3], [2]}

  Choose `done` by the result that must be safe first: the result of `Situ.each/3` has a message once the function has
  returned, and `Situ.Store.write/4` with `after_commit: true` returns the messages that are in the recording.
  `acknowledge(events, events)` acknowledges events as soon as the pipeline has taken them.

  An event is successful when `done` has a message with its originating time. An event is missing when only later
  messages have arrived: a filter or a component with `on_error: :skip` dropped it. So `done` must keep the times of the
  events, as operators do unless they shift times. An event that has neither is not acknowledged, whether the pipeline
  continues, ends, fails or is killed. If the acknowledger raises, it may be called again with the same events.

  Events of Broadway producers are acknowledged by their `acknowledger`, with one call of `ack/3` for each reference.
  Options, in addition to `Situ.Graph.Placement`:

    * `with:` a function that is called instead, for other producers: `fn successful, failed -> ... end`, two lists of
      events.
    * `missing:` `:failed` (default) or `:successful`, for streams that filter or aggregate on purpose.
    * `fail_after:` ns of the pipeline's clock. An event without a result after so long has failed. Without it, an event
      that is dropped waits until a later one arrives at `done`. Set it for a producer that sends no more before its
      events are acknowledged, and keep it longer than the pipeline needs for an event.
  """
  @spec acknowledge(Situ.Stream.t(), Situ.Stream.t(), keyword()) :: :ok
  def acknowledge(events, done, opts \\ [])

  def acknowledge(%Situ.Stream{} = events, %Situ.Stream{} = done, opts) do
    {policy, opts} = Keyword.pop(opts, :policy, Situ.Delivery.unlimited())
    own = [default_name: "Acknowledge"]
    node = Situ.Pipeline.add(events.pipeline, Situ.GenStage.Acknowledger, own ++ opts)
    Situ.Pipeline.connect(events, node, :events, policy: policy)
    Situ.Pipeline.connect(done, node, :done, policy: policy)
    :ok
  end

  def acknowledge(other, _arg2, _arg3),
    do: Argument.raise_invalid!(other, :stream, "Situ.GenStage.acknowledge(events, done)")

  defp add_outlet(stream, opts) do
    node =
      Situ.Pipeline.add(
        stream.pipeline,
        Situ.GenStage.Outlet,
        [outputs: [out: stream.type]] ++ opts
      )

    Situ.Pipeline.connect(stream, node, :in)
    Situ.Node.streams(node)
  end
end

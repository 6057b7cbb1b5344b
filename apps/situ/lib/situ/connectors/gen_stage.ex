defmodule Situ.GenStage do
  @moduledoc """
  Connects GenStage and Flow to pipelines. Situ's processes use GenStage's message protocol, so a GenStage consumer
  can subscribe to any output, and a GenStage producer can be a source. Situ does not depend on GenStage.

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

  ## A GenStage producer as a source

      stream = Situ.GenStage.from(p, producer, type: :integer)

  Events that are `%Situ.Message{}` structs keep their originating times. Other events get the time of the pipeline's
  clock, at least 1 ns after the event before. When the producer ends normally (`:normal`, `:shutdown`,
  `{:shutdown, _}`), the stream completes. Any other reason is a `:producer_failed` error of the component, which
  fails the pipeline unless its `on_error:` option prevents it.

  Without a producer, as in `from(p, [])`, the stream waits until a producer is assigned with
  `Flow.into_stages(flow, [pid])` or `GenStage.sync_subscribe(pid, to: producer)`. `subscription/2` returns this
  `pid`.

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
  """
  alias Situ.Argument
  alias Situ.Pipeline.Client

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

  The options are `type:`, `subscribe:` and the placement options. `subscribe:` holds options for the
  producers, such as `partition:`, `selector:`, `max_demand:` (default 1,000), `min_demand:` (default half of
  `max_demand:`) and `cancel:`. With `cancel: :temporary`, a producer's failure ends only its subscription.
  """
  @spec from(Situ.Pipeline.t(), GenServer.server() | [GenServer.server()], keyword()) ::
          Situ.Stream.t()
  def from(p, producers, opts \\ [])

  def from(%Situ.Graph.Handle{} = p, producers, opts) do
    {type, opts} = Keyword.pop(opts, :type, :any)
    own = [producers: List.wrap(producers), default_name: "GenStage", outputs: [out: type]]
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

  def accumulate(%Situ.Stream{} = stream, opts) do
    own = [default_name: "Accumulate", outputs: [out: stream.type]]
    node = Situ.Pipeline.add(stream.pipeline, Situ.GenStage.Gate, own ++ opts)
    Situ.Pipeline.connect(stream, node, :in)
    Situ.Node.streams(node)
  end

  def accumulate(other, _arg2),
    do: Argument.raise_invalid!(other, :stream, "Situ.GenStage.accumulate(stream)")
end

defmodule Situ.GenStage.Gate do
  @moduledoc false
  # Holds messages back until a consumer sets the demand to `:forward`.
  use Situ.Component, inputs: [in: :any], outputs: [out: :any]

  @impl true
  def handle_start(_context, state), do: {[{:demand, :accumulate}], state}

  @impl true
  def handle_message(:in, message, _context, state), do: {[{:out, message}], state}

  @impl true
  def handle_messages(:in, messages, _context, state), do: {[{:out, messages}], state}
end

defmodule Situ.GenStage.Source do
  @moduledoc false
  # The consumer side of the protocol: requests `max_demand` events from each producer, and more once the pipeline has
  # consumed part of them.
  use Situ.Component,
    outputs: [out: :any],
    options: [
      producers: [type: {:list, :any}, default: []],
      subscribe: [type: :keyword, default: []]
    ]

  alias Situ.{Error, Message}

  @max_demand 1_000

  @impl true
  def init(opts) do
    with {:ok, _, _} <- validate_demand(opts[:subscribe]),
         do: {:ok, %{opts: opts, subs: %{}, last: nil, ended: false}}
  end

  @impl true
  def handle_start(_context, %{opts: opts} = state) do
    state = Enum.reduce(opts[:producers], state, &start_subscription(&2, &1, opts[:subscribe]))
    {if(opts[:producers] == [], do: [{:complete, :infinity}], else: []), state}
  end

  defp start_subscription(state, producer, opts) do
    case subscribe_producer(state, producer, opts) do
      {:ok, _ref, state} -> state
      {:error, error} -> raise error
    end
  end

  # The pipeline has room: requests the consumed events again once they are at least `max - min`.
  @impl true
  def handle_demand(_n, _context, state) do
    {[], %{state | subs: Map.new(state.subs, fn {ref, sub} -> {ref, request_more(ref, sub)} end)}}
  end

  defp request_more(ref, %{taken: taken, max: max, min: min} = sub)
       when taken > 0 and taken >= max - min do
    send(sub.pid, {:"$gen_producer", {self(), ref}, {:ask, taken}})
    %{sub | taken: 0}
  end

  defp request_more(_ref, sub), do: sub

  @impl true
  def handle_info({:"$gen_consumer", {_pid, ref}, {:cancel, reason}}, context, state)
      when is_map_key(state.subs, ref),
      do: remove_subscription(ref, reason, context, state)

  def handle_info({:"$gen_consumer", {_pid, ref}, events}, context, state)
      when is_map_key(state.subs, ref) and is_list(events) do
    n = length(events)
    state = update_in(state.subs[ref].taken, &(&1 + n))

    # The last event is stamped with the current time, unless the earlier events leave too little room before it.
    first =
      max(context.now - n + 1, if(state.last, do: state.last + 1, else: context.now - n + 1))

    {actions, last} = Enum.map_reduce(events, {first, state.last}, &event_action/2)
    {actions, %{state | last: elem(last, 1)}}
  end

  def handle_info({:DOWN, ref, :process, _pid, reason}, context, state)
      when is_map_key(state.subs, ref),
      do: remove_subscription(ref, reason, context, state)

  # Both arrive as separate messages, because skipping an error undoes only the effects of the message that raised.
  def handle_info({:situ_producer_failed, error}, _context, _state), do: raise(error)

  def handle_info(:situ_producer_ended, context, %{subs: subs, ended: false} = state)
      when subs == %{} do
    if state.opts[:producers] == [],
      do: {[], state},
      else: {[{:complete, state.last || context.now}], %{state | ended: true}}
  end

  def handle_info(_other, _context, state), do: {[], state}

  @impl true
  def handle_request({:"$subscribe", _current, to, opts}, from, _context, state) do
    case if(state.ended,
           do: {:error, not_running_error()},
           else: subscribe_producer(state, to, opts)
         ) do
      {:ok, ref, state} -> send_reply(from, {:ok, ref}, state)
      {:error, error} -> send_reply(from, {:error, error}, state)
    end
  end

  def handle_request(request, from, _context, state) do
    what =
      "a GenStage source does not support the request #{inspect(request, limit: 8, printable_limit: 80)}"

    send_reply(from, {:error, Error.new(:unknown_request, what)}, state)
  end

  defp send_reply(nil, _answer, state), do: {[], state}

  defp send_reply(from, answer, state) do
    GenServer.reply(from, answer)
    {[], state}
  end

  @impl true
  def handle_stop(_final, _context, state), do: {[], cancel_subscriptions(state)}

  @impl true
  def terminate(_reason, state), do: cancel_subscriptions(state)

  defp subscribe_producer(state, producer, opts) do
    with {:ok, max, min} <- validate_demand(opts), {:ok, pid} <- resolve_producer(producer) do
      ref = Process.monitor(pid)
      opts = Keyword.merge(opts, max_demand: max, min_demand: min)
      send(pid, {:"$gen_producer", {self(), ref}, {:subscribe, nil, opts}})
      send(pid, {:"$gen_producer", {self(), ref}, {:ask, max}})
      cancel = Keyword.get(opts, :cancel, :permanent)
      sub = %{pid: pid, taken: 0, max: max, min: min, cancel: cancel}
      {:ok, ref, put_in(state.subs[ref], sub)}
    end
  end

  defp validate_demand(opts) do
    max = is_list(opts) && Keyword.keyword?(opts) && Keyword.get(opts, :max_demand, @max_demand)
    min = is_integer(max) && Keyword.get(opts, :min_demand, div(max, 2))

    if is_integer(min) and max > 0 and min >= 0 and min < max,
      do: {:ok, max, min},
      else: {:error, bad_subscription_error(opts)}
  end

  defp bad_subscription_error(opts) do
    Error.new(:bad_subscription, "cannot subscribe with #{inspect(opts, limit: 8)}",
      why: "the options must be a keyword list with 0 <= min_demand < max_demand"
    )
  end

  defp resolve_producer(producer) do
    case GenServer.whereis(producer) do
      nil -> {:error, no_producer_error(producer)}
      pid -> {:ok, pid}
    end
  rescue
    # The term is not a valid process name.
    FunctionClauseError -> {:error, no_producer_error(producer)}
  end

  defp no_producer_error(producer),
    do: Error.new(:no_producer, "cannot subscribe to #{inspect(producer)}: process not found")

  defp not_running_error,
    do: Error.new(:not_running, "the stream has ended", why: "its producers ended")

  defp cancel_subscriptions(state) do
    for {ref, sub} <- state.subs do
      send(sub.pid, {:"$gen_producer", {self(), ref}, {:cancel, :normal}})
      Process.demonitor(ref, [:flush])
    end

    %{state | subs: %{}, ended: true}
  end

  defp remove_subscription(ref, reason, _context, state) do
    Process.demonitor(ref, [:flush])
    {sub, subs} = Map.pop(state.subs, ref)

    if not orderly_exit?(reason) and sub.cancel != :temporary,
      do: send(self(), {:situ_producer_failed, producer_failed_error(sub.pid, reason)})

    send(self(), :situ_producer_ended)
    {[], %{state | subs: subs}}
  end

  defp orderly_exit?(reason), do: reason in [:normal, :shutdown] or match?({:shutdown, _}, reason)

  defp producer_failed_error(pid, reason) do
    Error.new(
      :producer_failed,
      "the GenStage producer #{inspect(pid)} failed: #{format_reason(reason)}",
      why: "it canceled the subscription or exited with this reason",
      fix: "see the producer's log; a partition dispatcher needs subscribe: [partition: ...]",
      meta: %{reason: reason}
    )
  end

  defp format_reason(%{__exception__: true} = error), do: Exception.message(error)
  defp format_reason(reason), do: Exception.format_exit(reason)

  defp event_action(%Message{originating_time: time} = message, {next, _last}),
    do: {{:out, time, message.data}, {max(next, time + 1), time}}

  defp event_action(data, {next, _last}), do: {{:out, next, data}, {next + 1, next}}
end

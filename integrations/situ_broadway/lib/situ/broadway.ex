defmodule Situ.Broadway do
  @moduledoc """
  Connects Situ's pipelines with Broadway and Flow.

  | from | to | how |
  |---|---|---|
  | a stream of a pipeline | Broadway | the producer `Situ.Broadway.Producer` |
  | a Broadway producer (SQS, Kafka, RabbitMQ ...) | a stream | `from/3`, with `Situ.GenStage.acknowledge/3` |
  | a stream of a pipeline | Flow | `flow/3` |
  | a Flow | a stream | `Situ.GenStage.from(p, [], name: "In")`, then `connect_flow/4` |
  | a stream of a pipeline | several GenStage consumers | `Situ.GenStage.dispatch/3`, without this package |
  """
  alias Situ.Broadway.ProducerGroup

  @schema [
    concurrency: [type: :pos_integer, default: 1, doc: "The number of producers."],
    transformer: [
      type: {:optional, {:tuple, [:module, :atom, :keyword]}},
      default: nil,
      doc:
        "As in Broadway: the function that makes a `Broadway.Message` of an event of another GenStage producer."
    ],
    broadway: [
      type: :keyword,
      default: [],
      doc: "Options of Broadway that the producer reads, in addition to `name:` and `producer:`."
    ]
  ]

  @doc """
  Returns the messages of a Broadway producer as a stream of `%Broadway.Message{}` structs.

      orders = Situ.Broadway.from(p, {BroadwaySQS.Producer, queue_url: url}, concurrency: 2)
      done = orders |> Situ.map(& &1.data) |> Situ.each(&Shop.put_order/1)
      Situ.GenStage.acknowledge(orders, done)

  The producers are started when the pipeline starts, with the callback `prepare_for_start/2` if they have one, and end
  with it. Nothing is acknowledged without `Situ.GenStage.acknowledge/3`. The failure of a producer is an error of the
  source: `on_error: :restart` starts new producers.

  Options, in addition to the options of `Situ.GenStage.from/3`:

  #{Situ.Options.docs(@schema)}
  """
  @spec from(Situ.Pipeline.t(), {module(), term()}, keyword()) :: Situ.Stream.t()
  def from(p, {module, arg}, opts \\ []) do
    {own, opts} = Keyword.split(opts, Keyword.keys(@schema))
    own = Situ.Options.validate!(own, @schema)
    opts = Keyword.put_new(opts, :name, module |> Module.split() |> Enum.join())
    events = Situ.GenStage.from(p, fn -> ProducerGroup.start_link({module, arg}, own) end, opts)

    case own[:transformer] do
      nil -> events
      {module, fun, arg} -> Situ.map(events, &apply(module, fun, [&1, arg]))
    end
  end

  @doc """
  Returns a Flow of the `%Situ.Message{}` structs of a named stream. The component must have one output. With several
  stages, the stream must come from `Situ.GenStage.dispatch(stream, :demand)`; otherwise each stage gets all messages.

      {:ok, flow} = Situ.Broadway.flow(pipeline, "Words", stages: 4)
      flow |> Flow.partition(key: & &1.data) |> Flow.reduce(fn -> %{} end, &count/2) |> Enum.to_list()

  The options are passed to `Flow.from_stages/2`.
  """
  @spec flow(Situ.Pipeline.target(), String.t(), keyword()) ::
          {:ok, Flow.t()} | {:error, Situ.Error.t()}
  def flow(pipeline, name, opts \\ []) do
    with {:ok, {pid, _subscription}} <- Situ.GenStage.subscription(pipeline, name),
         do: {:ok, Flow.from_stages([pid], opts)}
  end

  @doc """
  Sends the events of a Flow to a source of a running pipeline, which `Situ.GenStage.from(p, [], name: name)` has made.
  Returns the process of the Flow, which is linked to the caller. Options: options of the subscription, such as
  `max_demand:`.
  """
  @spec connect_flow(Flow.t(), Situ.Pipeline.target(), String.t(), keyword()) ::
          GenServer.on_start() | {:error, Situ.Error.t()}
  def connect_flow(flow, pipeline, name, opts \\ []) do
    with {:ok, {pid, _subscription}} <- Situ.GenStage.subscription(pipeline, name),
         do: Flow.into_stages(flow, [{pid, opts}])
  end
end

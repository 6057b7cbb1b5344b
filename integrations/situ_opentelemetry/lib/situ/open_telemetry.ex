defmodule Situ.OpenTelemetry do
  @schema [
    metrics: [
      type: :boolean,
      default: true,
      doc:
        "Whether to report the metrics of `Situ.Metrics`. Needs the package `opentelemetry_api_experimental`."
    ],
    logs: [
      type: :boolean,
      default: true,
      doc: "Whether log lines of pipelines and components get the ids of their spans."
    ],
    messages: [
      type: {:list, {:tuple, [:string, :string]}},
      default: [],
      doc:
        "Pipelines and streams (`{\"Lobby\", \"Speech\"}`) of which messages are traced, see below."
    ],
    every: [
      type: :pos_integer,
      default: 1_000,
      doc: "The minimum time between two traced messages of a stream, in ms."
    ]
  ]

  @moduledoc """
  Reports the pipelines of this node to OpenTelemetry: spans, metrics, and log lines with trace ids.

      children = [Situ.OpenTelemetry, {Lobby, []}]

  The SDK and the exporter are the application's own: add `opentelemetry_exporter` and `opentelemetry` to its
  dependencies, and `opentelemetry_experimental` for metrics.

  ## Spans

  | span | from | to | attributes |
  |---|---|---|---|
  | `pipeline NAME` | start | end | `situ.pipeline`, `situ.errors` |
  | `component PATH`, a child | start of the pipeline | its end | `situ.component`, `situ.messages.in`, `situ.messages.out`, `situ.messages.dropped`, `situ.errors`, `situ.restarts`, `situ.busy_ms` |
  | `message STREAM`, a separate trace | originating time | arrival at the last component | `situ.pipeline`, `situ.stream`, a link to the pipeline |
  | `FROM to TO`, a child of the message | the component FROM began to handle it | the component TO took the result | `situ.queue` |

  Errors of components are events of the component's span, with the exception. A pipeline or component that failed has
  the status `error`. OpenTelemetry exports a span when it ends, so pipelines that run for days appear late; metrics and
  messages appear immediately.

  A message is traced when it arrives at the named stream, at most one every `every:` ms. The times come from
  `Situ.trace/2`, so they are accurate to one millisecond.

  ## Metrics

  All metrics of `Situ.Metrics`, at the interval of the SDK's reader. A histogram is reported as its sum and count.

  ## Logs

  Log events with the metadata `pipeline` get `otel_trace_id`, `otel_span_id` and `otel_trace_flags`, which the SDK's
  log handler and formatters read. A line of a component gets the id of the component's span.

  ## Options

  #{Situ.Options.docs(@schema)}
  """
  use Supervisor

  alias Situ.OpenTelemetry.{LogFilter, MessageTracer, Metrics, Spans}

  @doc "Starts reporting. One process per node is enough."
  @spec start_link(keyword()) :: Supervisor.on_start()
  def start_link(opts \\ []),
    do: Supervisor.start_link(__MODULE__, Situ.Options.validate!(opts, @schema), name: __MODULE__)

  @impl true
  def init(opts) do
    tracers =
      for {pipeline, stream} = target <- opts[:messages] do
        args = %{pipeline: pipeline, stream: stream, every: opts[:every]}
        Supervisor.child_spec({MessageTracer, args}, id: target)
      end

    logs = if opts[:logs], do: [LogFilter], else: []
    metrics = if opts[:metrics], do: [Metrics], else: []
    Supervisor.init([Spans] ++ logs ++ metrics ++ tracers, strategy: :one_for_one)
  end

  @doc """
  Returns the context of the span of a running pipeline, or of one of its components, to link it with other spans.
  `:undefined` if there is none.
  """
  @spec span(String.t(), String.t() | nil) :: :opentelemetry.span_ctx() | :undefined
  def span(pipeline, component \\ nil), do: Spans.find(pipeline, component)
end

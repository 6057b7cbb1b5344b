defmodule Situ.OpenTelemetry.Spans do
  @moduledoc false
  # Owns the spans of pipelines and components. The events of the pipelines arrive as messages, so a slow exporter never
  # delays a pipeline. Log filters and tracers of messages read the spans from a table.
  use GenServer
  require OpenTelemetry.Tracer, as: Tracer
  alias OpenTelemetry.{Ctx, Span}

  @table __MODULE__
  @events [[:situ, :pipeline, :start], [:situ, :pipeline, :stop], [:situ, :component, :error]]

  def start_link(_opts), do: GenServer.start_link(__MODULE__, [], name: __MODULE__)

  @spec find(String.t(), String.t() | nil) :: :opentelemetry.span_ctx() | :undefined
  def find(pipeline, component) do
    case :ets.lookup(@table, {pipeline, component}) do
      [{_key, span}] -> span
      [] when component != nil -> find(pipeline, nil)
      [] -> :undefined
    end
  rescue
    # The table is gone while this process restarts.
    ArgumentError -> :undefined
  end

  @doc "The handler of `:telemetry`, called in the process of a pipeline."
  def handle_event(event, measurements, metadata, spans),
    do:
      send(
        spans,
        {event, self(), Map.put(measurements, :now, OpenTelemetry.timestamp()), metadata}
      )

  @impl true
  def init(_opts) do
    Process.flag(:trap_exit, true)
    :ets.new(@table, [:named_table, read_concurrency: true])
    :telemetry.attach_many(__MODULE__, @events, &__MODULE__.handle_event/4, self())
    now = OpenTelemetry.timestamp()
    {:ok, Enum.reduce(Situ.Pipeline.list(), %{}, &start_spans(&2, {&1.pid, &1.name}, now))}
  end

  @impl true
  def handle_info({[:situ, :pipeline, :start], pid, %{now: now}, %{pipeline: name}}, state),
    do: {:noreply, start_spans(state, {pid, name}, now)}

  def handle_info({[:situ, :pipeline, :stop], pid, %{now: now}, metadata}, state)
      when is_map_key(state, pid) do
    {pipeline, state} = Map.pop(state, pid)
    Process.demonitor(pipeline.monitor, [:flush])
    end_spans(pipeline, metadata.report, now)
    {:noreply, state}
  end

  def handle_info({[:situ, :component, :error], pid, _, %{error: error} = metadata}, state)
      when is_map_key(state, pid) do
    span = find(state[pid].name, metadata.component)
    Span.record_exception(span, error, nil, error_attributes(error))
    Span.set_status(span, OpenTelemetry.status(:error, Exception.message(error)))
    {:noreply, state}
  end

  # The pipeline was killed.
  def handle_info({:DOWN, _ref, :process, pid, reason}, state) when is_map_key(state, pid) do
    {pipeline, state} = Map.pop(state, pid)
    Span.set_status(pipeline.span, OpenTelemetry.status(:error, Exception.format_exit(reason)))
    end_spans(pipeline, nil, OpenTelemetry.timestamp())
    {:noreply, state}
  end

  def handle_info(_other, state), do: {:noreply, state}

  @impl true
  def terminate(_reason, state) do
    :telemetry.detach(__MODULE__)
    for {_pid, pipeline} <- state, do: end_spans(pipeline, nil, OpenTelemetry.timestamp())
  end

  defp start_spans(state, {pid, name}, start_time) do
    options = %{attributes: %{"situ.pipeline" => name}, start_time: start_time}
    span = Tracer.start_span("pipeline #{name}", options)
    :ets.insert(@table, {{name, nil}, span})

    pipeline = %{
      name: name,
      span: span,
      start_time: start_time,
      components: %{},
      monitor: Process.monitor(pid)
    }

    Map.put(state, pid, add_components(pipeline, component_paths(pid)))
  end

  defp add_components(pipeline, paths) do
    ctx = Tracer.set_current_span(Ctx.new(), pipeline.span)

    new =
      for path <- paths, not is_map_key(pipeline.components, path), into: %{} do
        attributes = %{"situ.pipeline" => pipeline.name, "situ.component" => path}
        options = %{attributes: attributes, start_time: pipeline.start_time}
        span = Tracer.start_span(ctx, "component #{path}", options)
        :ets.insert(@table, {{pipeline.name, path}, span})
        {path, span}
      end

    %{pipeline | components: Map.merge(pipeline.components, new)}
  end

  defp component_paths(pid) do
    case Situ.Pipeline.info(pid) do
      %{nodes: nodes} -> Enum.map(nodes, & &1.path)
      _ended -> []
    end
  rescue
    # It has ended already.
    Situ.Error -> []
  end

  defp end_spans(pipeline, report, now) do
    nodes = if report && report.snapshot, do: report.snapshot.nodes, else: []
    # Components that were added later, or all of a pipeline that ended soon.
    pipeline =
      add_components(pipeline, for(%{kind: kind, path: path} <- nodes, kind != :tap, do: path))

    for {path, span} <- pipeline.components do
      node = Enum.find(nodes, &(&1.path == path))
      if node, do: Span.set_attributes(span, component_attributes(node, report.snapshot))
      Span.end_span(span, now)
    end

    if report, do: end_pipeline(pipeline.span, report)
    Span.end_span(pipeline.span, now)
    :ets.match_delete(@table, {{pipeline.name, :_}, :_})
  end

  defp end_pipeline(span, report) do
    Span.set_attribute(span, "situ.errors", length(report.errors))

    with [error | _] <- report.errors,
         do: Span.set_status(span, OpenTelemetry.status(:error, Exception.message(error)))
  end

  defp component_attributes(node, snapshot) do
    taps = for %{kind: :tap, id: id} <- snapshot.nodes, do: id
    into = Enum.filter(snapshot.edges, &(&1.to == node.id))
    out_of = Enum.filter(snapshot.edges, &(&1.from == node.id and &1.to not in taps))
    sum = fn edges, key -> edges |> Enum.map(&Map.fetch!(&1, key)) |> Enum.sum() end

    %{
      "situ.messages.in" => sum.(into, :processed),
      "situ.messages.out" => count_emitted(out_of),
      "situ.messages.dropped" => sum.(into, :dropped),
      "situ.busy_ms" => div(sum.(into, :busy), 1_000_000),
      "situ.errors" => node.errors,
      "situ.restarts" => node.restarts
    }
  end

  # Every consumer of an output has an edge.
  defp count_emitted(edges) do
    edges
    |> Enum.group_by(& &1.from_output, & &1.emitted)
    |> Enum.map(fn {_output, counts} -> Enum.max(counts) end)
    |> Enum.sum()
  end

  defp error_attributes(error) do
    for {key, value} <- [code: error.code, originating_time: error.meta[:originating_time]],
        value != nil,
        do: {"situ.#{key}", value}
  end
end

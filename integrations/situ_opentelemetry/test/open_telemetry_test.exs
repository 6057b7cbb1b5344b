defmodule Situ.OpenTelemetryTest do
  # All signals take the real way: SDK, exporter, OTLP over HTTP, and are decoded by a receiver.
  use ExUnit.Case, async: false

  import OtlpReceiver, only: [attributes: 1, await: 2]
  require Logger
  alias Situ.Pipeline

  @moduletag :capture_log

  setup do
    {:ok, _} = OtlpReceiver.subscribe()
    :ok
  end

  defp start(name, fun) do
    {:ok, p} = Pipeline.start(fn p -> fun.(p) end, pipeline: [name: name])
    p
  end

  defp numbers(p), do: Situ.timer(p, every: Situ.Time.ms(1), name: "Numbers")

  test "a pipeline and its components are spans" do
    start_supervised!({Situ.OpenTelemetry, metrics: false})

    p =
      start("Spans", &(&1 |> numbers() |> Situ.each(fn _ -> :ok end, name: "Count", async: true)))

    await_messages(p, 5)
    {:ok, report} = Pipeline.stop(p)

    sink = await("/v1/traces", &(&1.name == "component Count"))
    assert %{"situ.pipeline" => "Spans", "situ.messages.in" => n} = attributes(sink)
    assert [%{processed: ^n}] = for(e <- report.snapshot.edges, e.kind == :process, do: e)

    pipeline = await("/v1/traces", &(&1.name == "pipeline Spans"))
    assert sink.trace_id == pipeline.trace_id
    assert sink.parent_span_id == pipeline.span_id
    assert pipeline.parent_span_id == ""
    assert %{"situ.errors" => 0} = attributes(pipeline)
    took = pipeline.end_time_unix_nano - pipeline.start_time_unix_nano
    assert took > Situ.Time.ms(4)
  end

  defp await_messages(p, n) do
    unless Enum.any?(Pipeline.info(p).edges, &(&1.processed >= n)), do: await_messages(p, n)
  end

  test "an error of a component is an exception of its span" do
    start_supervised!({Situ.OpenTelemetry, metrics: false})

    p =
      start("Errors", fn p ->
        p
        |> Situ.from_enumerable([1, 0, 2], every: Situ.Time.ms(1))
        |> Situ.map(&div(6, &1), name: "Divide", on_error: :skip, async: true)
      end)

    {:ok, _} = Pipeline.await(p, 10_000)
    span = await("/v1/traces", &(&1.name == "component Divide"))
    assert span.status.code == :STATUS_CODE_ERROR
    assert [%{name: "exception"} = event] = span.events
    assert attributes(event)["exception.message"] =~ "bad argument in arithmetic"
    assert %{"situ.errors" => 1} = attributes(span)
  end

  test "a killed pipeline has a span with an error" do
    start_supervised!({Situ.OpenTelemetry, metrics: false})
    p = start("Killed", &numbers/1)
    await_span("Killed")
    Process.exit(p, :kill)
    span = await("/v1/traces", &(&1.name == "pipeline Killed"))
    assert span.status == %{code: :STATUS_CODE_ERROR, message: "killed"}
    assert Situ.OpenTelemetry.span("Killed") == :undefined
  end

  defp await_span(name) do
    if Situ.OpenTelemetry.span(name) == :undefined, do: await_span(name)
  end

  test "some messages are traces, with a span for each connection" do
    start_supervised!(
      {Situ.OpenTelemetry, metrics: false, messages: [{"Traced", "Slow"}], every: 50}
    )

    p =
      start("Traced", fn p ->
        p
        |> Situ.timer(every: Situ.Time.ms(20), name: "Numbers")
        |> Situ.map(fn n -> :timer.sleep(5) && n end, name: "Slow", async: true)
        |> Situ.each(fn _ -> :ok end, name: "Sink", async: true)
      end)

    message = await("/v1/traces", &(&1.name == "message Slow"))
    assert %{"situ.pipeline" => "Traced", "situ.stream" => "Slow"} = attributes(message)
    assert [%{trace_id: linked}] = message.links

    assert linked ==
             :binary.encode_unsigned(:otel_span.trace_id(Situ.OpenTelemetry.span("Traced")))

    slow = await("/v1/traces", &(&1.name == "Slow to Sink"))
    assert slow.end_time_unix_nano - slow.start_time_unix_nano >= 4_000_000
    {:ok, _} = Pipeline.stop(p)
  end

  test "the metrics of Situ arrive" do
    start_supervised!({Situ.OpenTelemetry, logs: false})

    p =
      start(
        "Measured",
        &(&1 |> numbers() |> Situ.each(fn _ -> :ok end, name: "Sink", async: true))
      )

    metric = await("/v1/metrics", &measures?(&1, :situ_messages_processed_total, "Measured"))
    assert {:sum, %{is_monotonic: true, data_points: points}} = metric.data
    [point] = Enum.filter(points, &(attributes(&1)["pipeline"] == "Measured"))
    assert %{"from" => "Numbers.out", "to" => "Sink.in"} = attributes(point)

    running = await("/v1/metrics", &measures?(&1, :situ_pipeline_running, "Measured"))
    assert {:gauge, _} = running.data
    {:ok, _} = Pipeline.stop(p)
  end

  defp measures?(metric, name, pipeline) do
    {_kind, %{data_points: points}} = metric.data

    metric.name == Atom.to_string(name) and
      Enum.any?(points, &(attributes(&1)["pipeline"] == pipeline))
  end

  test "log lines of a component have the ids of its span" do
    start_supervised!({Situ.OpenTelemetry, metrics: false})
    url = Application.fetch_env!(:opentelemetry_experimental, :otlp_endpoint)

    :ok =
      :logger.add_handler(:otlp_test, :otel_log_handler, %{
        scheduled_delay_ms: 20,
        exporter: {:otel_exporter_logs_otlp, %{endpoints: [url], protocol: :http_protobuf}}
      })

    on_exit(fn -> :logger.remove_handler(:otlp_test) end)

    p =
      start("Logged", fn p ->
        knocks = Stream.repeatedly(fn -> :knock end)

        p
        |> Situ.from_enumerable(knocks, every: Situ.Time.ms(50))
        |> Situ.each(&Logger.error("#{&1}"), name: "Speaker", async: true)
      end)

    log = await("/v1/logs", &match?(%{"component" => "Speaker"}, attributes(&1)))
    assert attributes(log)["pipeline"] == "Logged"
    span = Situ.OpenTelemetry.span("Logged", "Speaker")

    assert OpenTelemetry.Span.hex_trace_id(span) in [
             log.trace_id,
             Base.encode16(log.trace_id, case: :lower)
           ]

    assert OpenTelemetry.Span.hex_span_id(span) in [
             log.span_id,
             Base.encode16(log.span_id, case: :lower)
           ]

    {:ok, _} = Pipeline.stop(p)
  end

  test "the handlers of :telemetry receive the events of pipelines" do
    me = self()
    events = [[:situ, :pipeline, :start], [:situ, :pipeline, :stop]]

    :telemetry.attach_many(
      __MODULE__,
      events,
      fn event, _, meta, _ -> send(me, {event, meta}) end,
      nil
    )

    on_exit(fn -> :telemetry.detach(__MODULE__) end)
    {:ok, _} = Pipeline.run(fn _p -> :nothing end, pipeline: [name: "Told"])
    assert_receive {[:situ, :pipeline, :start], %{pipeline: "Told"}}

    assert_receive {[:situ, :pipeline, :stop],
                    %{pipeline: "Told", errors: 0, report: %Pipeline.Report{}}}
  end
end

# Sends the spans, metrics and log lines of a pipeline to an OpenTelemetry collector at localhost:4318 (or
# OTEL_EXPORTER_OTLP_ENDPOINT). Run it with: mix run --no-start examples/lobby.exs
#
# In an application, these settings are in config/runtime.exs.
url = System.get_env("OTEL_EXPORTER_OTLP_ENDPOINT", "http://localhost:4318")

Application.put_env(:opentelemetry, :resource, service: %{name: "lobby"})
Application.put_env(:opentelemetry_exporter, :otlp_endpoint, url)
exporter = fn module -> {module, %{endpoints: [url], protocol: :http_protobuf}} end
reader = %{export_interval_ms: 1_000, exporter: exporter.(:otel_exporter_metrics_otlp)}

Application.put_env(:opentelemetry_experimental, :readers, [
  %{module: :otel_metric_reader, config: reader}
])

# The exporter must start before the SDK.
for app <- [
      :opentelemetry_exporter,
      :opentelemetry,
      :opentelemetry_experimental,
      :situ_opentelemetry
    ],
    do: {:ok, _} = Application.ensure_all_started(app)

:ok =
  :logger.add_handler(:otlp, :otel_log_handler, %{
    level: :warning,
    # An interval without a line would stop the handler of opentelemetry_experimental 0.6.0 for good.
    scheduled_delay_ms: 3_000,
    exporter: exporter.(:otel_exporter_logs_otlp)
  })

defmodule Lobby do
  use Situ.Pipeline
  require Logger

  @impl true
  def build(p, _opts) do
    p
    |> Situ.from_enumerable(Stream.iterate(1, &(&1 + 1)), every: Situ.Time.ms(20), name: "Level")
    |> Situ.map(&measure/1, name: "Measure", on_error: :skip, async: true)
    |> Situ.each(&warn/1, name: "Warn", async: true)
  end

  defp measure(n) when rem(n, 50) == 0, do: raise("the sensor is silent")
  defp measure(n), do: :math.sin(n / 30)

  defp warn(level) when level > 0.999, do: Logger.warning("loud: #{Float.round(level, 4)}")
  defp warn(_level), do: :ok
end

{:ok, _} = Situ.OpenTelemetry.start_link(messages: [{"Lobby", "Measure"}])
{:ok, pipeline} = Situ.Pipeline.start(Lobby, [])
Process.sleep(3_500)
{:ok, report} = Situ.Pipeline.stop(pipeline)
IO.puts("skipped: #{inspect(report.skipped)}")
# Exports the last batch.
for app <- [:opentelemetry_experimental, :opentelemetry], do: Application.stop(app)

Code.require_file("otlp_receiver.exs", __DIR__)

{:ok, port} = OtlpReceiver.start()
url = "http://localhost:#{port}"

# Mix has started them without this configuration.
apps = [:opentelemetry_exporter, :opentelemetry, :opentelemetry_experimental]
for app <- Enum.reverse(apps), do: Application.stop(app)

for {app, env} <- [
      opentelemetry: [
        span_processor: :batch,
        traces_exporter: :otlp,
        bsp_scheduled_delay_ms: 20,
        text_map_propagators: []
      ],
      opentelemetry_exporter: [otlp_endpoint: url],
      opentelemetry_experimental: [
        otlp_endpoint: url,
        readers: [
          %{
            module: :otel_metric_reader,
            config: %{
              export_interval_ms: 50,
              exporter:
                {:otel_exporter_metrics_otlp, %{endpoints: [url], protocol: :http_protobuf}}
            }
          }
        ]
      ]
    ],
    {key, value} <- env,
    do: Application.put_env(app, key, value)

for app <- apps, do: {:ok, _} = Application.ensure_all_started(app)

ExUnit.start()

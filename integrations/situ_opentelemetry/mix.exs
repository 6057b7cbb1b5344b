Code.require_file("../integration.exs", __DIR__)
Situ.Integration.prepare()

defmodule Situ.OpenTelemetry.MixProject do
  use Mix.Project

  def project do
    Situ.Integration.project(:situ_opentelemetry,
      packages: [
        {:telemetry, "~> 1.0"},
        {:opentelemetry_api, "~> 1.4"},
        # Only for metrics, which the API does not contain yet.
        {:opentelemetry_api_experimental, "~> 0.5", optional: true},
        # The SDK belongs to the application. The exporter must start before it.
        {:opentelemetry_exporter, "~> 1.8", only: [:dev, :test]},
        {:opentelemetry, "~> 1.5", only: [:dev, :test]},
        {:opentelemetry_experimental, "~> 0.5", only: [:dev, :test]}
      ]
    )
  end

  def application, do: [extra_applications: [:logger, :situ]]
end

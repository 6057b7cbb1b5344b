Code.require_file("../integration.exs", __DIR__)
Situ.Integration.prepare()

defmodule Situ.Phoenix.MixProject do
  use Mix.Project

  def project do
    Situ.Integration.project(:situ_phoenix,
      packages: [
        {:phoenix, "~> 1.7"},
        {:phoenix_live_view, "~> 0.20 or ~> 1.0"},
        {:websock_adapter, "~> 0.5"},
        {:jason, "~> 1.4", only: :test},
        {:bandit, "~> 1.5", only: :test},
        {:plug_cowboy, "~> 2.7", only: :test},
        {:floki, ">= 0.36.0", only: :test}
      ]
    )
  end

  def application,
    do: [
      mod: {Situ.Phoenix.Application, []},
      extra_applications: [:logger, :situ, :situ_live, :situ_studio]
    ]
end

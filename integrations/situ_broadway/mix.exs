Code.require_file("../integration.exs", __DIR__)
Situ.Integration.prepare()

defmodule Situ.Broadway.MixProject do
  use Mix.Project

  def project do
    Situ.Integration.project(:situ_broadway,
      packages: [
        {:broadway, "~> 1.0"},
        {:flow, "~> 1.2"},
        {:gen_stage, "~> 1.2"},
        {:off_broadway_memory, "~> 1.2", only: :test}
      ]
    )
  end

  def application, do: [extra_applications: [:logger, :situ]]
end

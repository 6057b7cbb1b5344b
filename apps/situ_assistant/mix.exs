defmodule Situ.Assistant.MixProject do
  use Mix.Project

  def project do
    [
      app: :situ_assistant,
      version: "0.1.0",
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.14",
      start_permanent: Mix.env() == :prod,
      deps: deps()
    ]
  end

  def application do
    [extra_applications: extra_applications(Mix.env())]
  end

  defp extra_applications(:test), do: [:proper | extra_applications(:prod)]
  defp extra_applications(_env), do: [:logger]

  defp deps do
    [
      {:situ_types, in_umbrella: true},
      {:situ, in_umbrella: true},
      {:situ_store, in_umbrella: true},
      {:situ_media, in_umbrella: true},
      {:situ_infer, in_umbrella: true}
    ]
  end
end

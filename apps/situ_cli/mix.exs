defmodule Situ.CLI.MixProject do
  use Mix.Project

  def project do
    [
      app: :situ_cli,
      version: "0.1.0",
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.14",
      elixirc_paths: elixirc_paths(Mix.env()),
      start_permanent: Mix.env() == :prod,
      deps: deps()
    ]
  end

  def application do
    [extra_applications: extra_applications(Mix.env())]
  end

  defp elixirc_paths(:test), do: ["lib", "test/support"]
  defp elixirc_paths(_env), do: ["lib"]

  defp extra_applications(:test), do: [:proper | extra_applications(:prod)]
  defp extra_applications(_env), do: [:logger]

  defp deps do
    [
      {:situ_types, in_umbrella: true},
      {:situ, in_umbrella: true},
      {:situ_store, in_umbrella: true},
      {:situ_dataset, in_umbrella: true},
      {:situ_media, in_umbrella: true},
      {:situ_space, in_umbrella: true},
      {:situ_infer, in_umbrella: true},
      {:situ_assistant, in_umbrella: true},
      {:situ_bridge, in_umbrella: true},
      {:situ_remote, in_umbrella: true},
      {:situ_studio, in_umbrella: true}
    ]
  end
end

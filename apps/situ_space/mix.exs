defmodule Situ.Space.MixProject do
  use Mix.Project

  def project do
    [
      app: :situ_space,
      version: "0.1.0",
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.14",
      compilers: [:situ_native] ++ Mix.compilers(),
      native: [crates: ~w(situ_space_nif)],
      start_permanent: Mix.env() == :prod,
      deps: deps()
    ]
  end

  def application do
    [
      extra_applications: extra_applications(Mix.env()),
      env: [recording_formats: [Situ.Space.GeometryFile, Situ.Space.Gpx, Situ.Space.Robot.Urdf]]
    ]
  end

  defp extra_applications(:test), do: [:proper | extra_applications(:prod)]
  defp extra_applications(_env), do: [:logger, :xmerl]

  defp deps do
    [
      {:situ_types, in_umbrella: true},
      {:situ, in_umbrella: true},
      {:situ_store, in_umbrella: true},
      {:situ_media, in_umbrella: true},
      {:situ_build, in_umbrella: true, runtime: false}
    ]
  end
end

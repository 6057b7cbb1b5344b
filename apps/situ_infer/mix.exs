defmodule Situ.Infer.MixProject do
  use Mix.Project

  def project do
    [
      app: :situ_infer,
      version: "0.1.0",
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.14",
      elixirc_paths: elixirc_paths(Mix.env()),
      compilers: [:situ_native] ++ Mix.compilers(),
      native: [crates: ~w(situ_infer_nif), programs: ~w(situ_speak)],
      start_permanent: Mix.env() == :prod,
      deps: deps()
    ]
  end

  def application do
    [
      mod: {Situ.Infer.Application, []},
      env: [
        dataset_tasks: [
          Situ.Infer.Task.Anonymise,
          Situ.Infer.Task.Faces,
          Situ.Infer.Task.Transcript,
          Situ.Infer.Task.VoiceActivity
        ]
      ],
      extra_applications: extra_applications(Mix.env())
    ]
  end

  defp elixirc_paths(:test), do: ["lib", "test/support"]
  defp elixirc_paths(_env), do: ["lib"]

  defp extra_applications(:test), do: [:proper | extra_applications(:prod)]
  defp extra_applications(_env), do: [:logger, :ssl, :public_key]

  defp deps do
    [
      {:situ_types, in_umbrella: true},
      {:situ, in_umbrella: true},
      {:situ_media, in_umbrella: true},
      {:situ_build, in_umbrella: true, runtime: false}
    ]
  end
end

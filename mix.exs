Code.require_file("config/mix_app.exs", __DIR__)

defmodule Situ.Umbrella.MixProject do
  use Mix.Project

  def project do
    [
      apps_path: "apps",
      version: Situ.MixApp.version(),
      elixir: "~> 1.14",
      start_permanent: Mix.env() == :prod,
      prune_code_paths: false,
      deps: [],
      releases: releases(),
      aliases: []
    ]
  end

  # One release with every app; the NIFs travel in each app's priv/native.
  defp releases do
    [
      situ: [
        include_executables_for: [:unix],
        # No cookie that other users of the machine can read.
        steps: [
          :assemble,
          &Situ.Build.Release.remove_cookie/1,
          &Situ.Build.Release.install_command_line/1
        ],
        applications: [
          situ_types: :permanent,
          situ: :permanent,
          situ_store: :permanent,
          situ_dataset: :permanent,
          situ_experiment: :permanent,
          situ_media: :permanent,
          situ_space: :permanent,
          situ_infer: :permanent,
          situ_assistant: :permanent,
          situ_link: :permanent,
          situ_cluster: :permanent,
          situ_bridge: :permanent,
          situ_python: :permanent,
          situ_live: :permanent,
          situ_studio: :permanent,
          situ_cli: :permanent,
          situ_examples: :permanent
        ]
      ]
    ]
  end
end

Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.CLI.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_cli,
      # Tests compile files while others are still loaded, and code versions are read from debug information.
      test_elixirc_options: [debug_info: true],
      deps: [
        :situ_types,
        :situ,
        :situ_store,
        :situ_dataset,
        :situ_experiment,
        :situ_media,
        :situ_space,
        :situ_infer,
        :situ_assistant,
        :situ_bridge,
        :situ_python,
        :situ_link,
        :situ_cluster,
        :situ_studio
      ]
    )
  end

  def application do
    Situ.MixApp.application()
  end
end

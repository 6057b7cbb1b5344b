Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Experiment.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_experiment,
      # Tests compile files while others are still loaded, and code versions are read from debug information.
      test_elixirc_options: [debug_info: true],
      deps: [:situ_types, :situ, :situ_store, :situ_dataset]
    )
  end

  def application, do: Situ.MixApp.application([:crypto])
end

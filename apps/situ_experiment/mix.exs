Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Experiment.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_experiment,
      deps: [:situ_types, :situ, :situ_store, :situ_dataset]
    )
  end

  def application, do: Situ.MixApp.application([:crypto])
end

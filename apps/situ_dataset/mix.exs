Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Dataset.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_dataset, deps: [:situ_types, :situ, :situ_store])
  end

  def application do
    Situ.MixApp.application([:crypto],
      env: [
        recording_formats: [Situ.Dataset.JsonStore],
        dataset_tasks: [Situ.Dataset.Task.Statistics, Situ.Dataset.Task.DropStreams]
      ]
    )
  end
end

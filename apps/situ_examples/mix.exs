Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Examples.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_examples,
      deps: [
        :situ_types,
        :situ,
        :situ_store,
        :situ_dataset,
        :situ_experiment,
        :situ_media,
        :situ_space,
        :situ_infer,
        :situ_link,
        :situ_cluster,
        :situ_studio,
        :situ_cli
      ]
    )
  end

  def application do
    Situ.MixApp.application([], env: [sample_recordings: [Situ.Examples.TalkSample]])
  end
end

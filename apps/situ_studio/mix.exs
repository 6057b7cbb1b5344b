Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Studio.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_studio,
      deps: [
        :situ_types,
        :situ,
        :situ_store,
        :situ_media,
        :situ_space,
        :situ_dataset,
        :situ_experiment,
        :situ_bridge,
        :situ_link,
        :situ_cluster,
        :situ_live
      ]
    )
  end

  def application do
    Situ.MixApp.application([:crypto], mod: {Situ.Studio.Application, []})
  end
end

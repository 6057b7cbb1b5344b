Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Link.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_link, deps: [:situ, :situ_store, :situ_types])
  end

  def application do
    Situ.MixApp.application([:crypto, :ssl, :public_key],
      mod: {Situ.Link.Application, []},
      env: [recording_formats: [Situ.Link.Recording], metrics: [Situ.Link.LinkMetrics]]
    )
  end
end

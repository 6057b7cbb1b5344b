Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Store.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_store,
      native: [crates: ~w(situ_store_nif)],
      deps: [:situ_types, :situ]
    )
  end

  def application do
    Situ.MixApp.application([],
      mod: {Situ.Store.Application, []},
      env: [
        recording_formats: [Situ.Store.Csv, Situ.Store.S3],
        metrics: [Situ.Store.StoreMetrics]
      ]
    )
  end
end

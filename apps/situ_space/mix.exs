Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Space.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_space,
      native: [crates: ~w(situ_space_nif)],
      deps: [:situ_types, :situ, :situ_store, :situ_media]
    )
  end

  def application do
    Situ.MixApp.application([],
      env: [recording_formats: [Situ.Space.GeometryFile, Situ.Space.Gpx, Situ.Space.Robot.Urdf]]
    )
  end
end

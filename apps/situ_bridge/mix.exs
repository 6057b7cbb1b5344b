Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Bridge.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_bridge,
      native: [crates: ~w(situ_bridge_nif), binaries: ~w(situ_parquet)],
      deps: [:situ, :situ_store, :situ_types]
    )
  end

  def application do
    Situ.MixApp.application([:crypto, :inets, :ssl, :public_key],
      env: [
        recording_formats: [
          Situ.Bridge.Psi,
          Situ.Bridge.Mcap,
          Situ.Bridge.Ros.Bag,
          Situ.Bridge.Ros.Db3,
          Situ.Bridge.TableRecording
        ],
        file_kinds: [Situ.Bridge.TableKinds]
      ]
    )
  end
end

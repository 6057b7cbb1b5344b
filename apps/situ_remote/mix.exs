Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Remote.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_remote, deps: [:situ, :situ_store, :situ_types])
  end

  def application do
    Situ.MixApp.application([:crypto, :ssl, :public_key],
      mod: {Situ.Remote.Application, []},
      env: [store_readers: [Situ.Remote.Recording]]
    )
  end
end

Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ, deps: [:situ_types])
  end

  def application do
    Situ.MixApp.application([:inets], mod: {Situ.Application, []})
  end
end

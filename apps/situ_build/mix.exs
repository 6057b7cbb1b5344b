Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Build.MixProject do
  use Mix.Project

  def project do
    Situ.MixApp.project(:situ_build, deps: [])
  end

  def application do
    Situ.MixApp.application()
  end
end

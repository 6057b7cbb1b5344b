Code.require_file("../../config/mix_app.exs", __DIR__)

defmodule Situ.Python.MixProject do
  use Mix.Project

  def project, do: Situ.MixApp.project(:situ_python, deps: [:situ, :situ_store, :situ_types])

  def application, do: Situ.MixApp.application()
end

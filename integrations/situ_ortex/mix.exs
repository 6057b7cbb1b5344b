Code.require_file("../integration.exs", __DIR__)
Situ.Integration.prepare()

defmodule Situ.Ortex.MixProject do
  use Mix.Project

  def project,
    do: Situ.Integration.project(:situ_ortex, packages: [{:ortex, "~> 0.1.10"}, {:nx, "~> 0.6"}])

  def application, do: [extra_applications: [:logger, :situ_infer]]
end

Code.require_file("../integration.exs", __DIR__)
Situ.Integration.prepare()

defmodule Situ.Evision.MixProject do
  use Mix.Project

  def project, do: Situ.Integration.project(:situ_evision, packages: [{:evision, "~> 0.2"}])

  def application, do: [extra_applications: [:logger, :situ]]
end

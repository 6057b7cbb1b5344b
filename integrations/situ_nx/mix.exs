Code.require_file("../integration.exs", __DIR__)
Situ.Integration.prepare()

defmodule Situ.Nx.MixProject do
  use Mix.Project

  def project, do: Situ.Integration.project(:situ_nx, packages: [{:nx, "~> 0.6"}])

  def application, do: [extra_applications: [:logger, :situ]]
end

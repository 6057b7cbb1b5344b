Code.require_file("../integration.exs", __DIR__)
Situ.Integration.prepare()

defmodule Situ.Livebook.MixProject do
  use Mix.Project

  def project, do: Situ.Integration.project(:situ_livebook, packages: [{:kino, "~> 0.19"}])

  def application,
    do: [
      mod: {Situ.Livebook.Application, []},
      extra_applications: [:logger, :situ, :situ_store, :situ_media, :situ_studio]
    ]
end

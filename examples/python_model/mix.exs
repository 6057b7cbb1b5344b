# The folder of Situ. Its compiled applications are used as they are.
situ = System.get_env("SITU_HOME") || Path.expand("../..", __DIR__)
Code.require_file("config/installed.exs", situ)

defmodule PythonModel.MixProject do
  use Mix.Project

  def project do
    [app: :python_model, version: "0.1.0", elixir: "~> 1.14", prune_code_paths: false, deps: []]
  end

  def application,
    do: [
      extra_applications: [:logger, :situ, :situ_store, :situ_media, :situ_python, :situ_examples]
    ]
end

# The folder of the installed Situ. Its compiled applications are used as they are.
situ = System.get_env("SITU_HOME") || "{{situ}}"
Code.require_file("config/installed.exs", situ)

defmodule {{Module}}.MixProject do
  use Mix.Project

  def project do
    [
      app: :{{app}},
      version: "0.1.0",
{{umbrella_paths}}      elixir: "~> 1.14",
      start_permanent: Mix.env() == :prod,
      # Situ's applications are on the code path, but are not dependencies that mix compiles.
      prune_code_paths: false,
      deps: [],
      releases: [{{app}}: [include_executables_for: [:unix]]]
    ]
  end

  # The first modules to look at: situ (pipelines), situ_store (recordings), situ_studio (the browser studio). Add
  # :situ_media for images and audio, :situ_infer for models, :situ_bridge for files of other systems.
  def application do
    [
      mod: {{{Module}}.Application, []},
      extra_applications: [:logger, :situ, :situ_store, :situ_studio]
    ]
  end
end

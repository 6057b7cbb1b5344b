defmodule {{Module}}.Umbrella.MixProject do
  use Mix.Project

  def project do
    [
      apps_path: "apps",
      version: "0.1.0",
      start_permanent: Mix.env() == :prod,
      # Situ's applications are on the code path, but are not dependencies that mix compiles.
      prune_code_paths: false,
      deps: [],
      releases: [
        {{app}}: [include_executables_for: [:unix], applications: [{{app}}: :permanent]]
      ]
    ]
  end
end

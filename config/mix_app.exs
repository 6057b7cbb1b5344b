defmodule Situ.MixApp do
  @moduledoc "The parts of a `mix.exs` that all apps share. The `mix.exs` of each app loads this file."

  @doc "Returns the version of all apps."
  @spec version() :: String.t()
  def version, do: "1.0.0"

  @doc """
  Returns the configuration of the project `app`.

  `deps:` lists the names of other apps. `native:` lists the Rust crates and programs that `situ_build` compiles. Mix
  receives all other options unchanged.
  """
  @spec project(atom(), keyword()) :: keyword()
  def project(app, opts) do
    {deps, opts} = Keyword.pop(opts, :deps, [])

    [
      app: app,
      version: version(),
      build_path: "../../_build",
      config_path: "../../config/config.exs",
      deps_path: "../../deps",
      lockfile: "../../mix.lock",
      elixir: "~> 1.14",
      elixirc_paths: elixirc_paths(Mix.env()),
      start_permanent: Mix.env() == :prod,
      deps: Enum.map(deps, &{&1, in_umbrella: true})
    ]
    |> add_native_build(opts[:native])
    |> Keyword.merge(opts)
  end

  @doc "Returns the `application/0` of an app that uses these applications of Erlang and Elixir besides the logger."
  @spec application([atom()], keyword()) :: keyword()
  def application(extra_applications \\ [], opts \\ []),
    do:
      [extra_applications: test_applications(Mix.env()) ++ [:logger | extra_applications]] ++ opts

  defp elixirc_paths(:test), do: ["lib", "test/support"]
  defp elixirc_paths(_env), do: ["lib"]

  defp test_applications(:test), do: [:proper]
  defp test_applications(_env), do: []

  defp add_native_build(project, nil), do: project

  defp add_native_build(project, _native) do
    project
    |> Keyword.put(:compilers, [:situ_native | Mix.compilers()])
    |> Keyword.update!(:deps, &(&1 ++ [{:situ_build, in_umbrella: true, runtime: false}]))
  end
end

defmodule Mix.Tasks.Situ.Check do
  @shortdoc "Checks that apps use each other only as the architecture allows"
  @moduledoc """
  Refuses every reference from one app to another that `Situ.Build.Architecture` does not list.

      $ mix situ.check

  The compiler's own warnings see calls only. This check reads the debug information of every compiled module, in
  which a struct literal (`%Sibling{}`) and a module name passed as a value are atoms like any other, and holds the
  declared dependencies of each `mix.exs` against the same table. Exit status: 0 fine, 1 with one line per violation.
  """
  use Mix.Task
  alias Situ.Build.Architecture

  @impl Mix.Task
  def run(_args) do
    lib = Path.join(Mix.Project.build_path(), "lib")
    modules = Architecture.modules(lib)

    case Architecture.violations(modules) ++ Architecture.undeclared(declared()) do
      [] ->
        Mix.shell().info("architecture: #{length(modules)} modules, every edge is allowed")

      problems ->
        Enum.each(problems, fn problem -> Mix.shell().error(problem) end)
        Mix.raise("#{length(problems)} edge(s) between apps that the architecture does not allow")
    end
  end

  defp declared do
    for {app, path} <- Mix.Project.apps_paths(), into: %{} do
      deps =
        Mix.Project.in_project(app, path, fn _ ->
          for {dep, opts} <- Mix.Project.config()[:deps], opts[:in_umbrella], do: dep
        end)

      {app, deps}
    end
  end
end

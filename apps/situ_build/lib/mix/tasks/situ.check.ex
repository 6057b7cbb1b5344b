defmodule Mix.Tasks.Situ.Check do
  @shortdoc "Checks the architecture: dependencies between apps, layers, cycles, file sizes"
  @moduledoc """
  Checks the compiled code and the sources against the architecture.

      $ mix situ.check

  It reports:

    * every reference from one app to another that `Situ.Build.Architecture` does not list, and every dependency in a
      `mix.exs` that the table does not allow;
    * every reference from a layer of the runtime to a higher layer (`Situ.Build.Layers`);
    * every cycle between the modules of an app or of a Rust crate (`Situ.Build.Cycles`);
    * files and lines that are too long (`Situ.Build.Sources`);
    * names and English that are worse than the limits allow (`Situ.Build.Limits`);
    * differences between the list of public modules and their documentation (`Situ.Build.PublicModules`);
    * functions that a guide or the documentation names and that do not exist (`Situ.Build.DocLinks`);
    * public signatures that changed without an entry in the changelog (`Situ.Build.Signatures`);
    * decision records that nothing cites (`Situ.Build.Decisions`);
    * subjects of commits that are not imperative or too long (`Situ.Build.Commits`).

  `mix situ.check --write-signatures [FILE]` checks nothing. It records the public signatures in `docs/signatures.txt`
  (or `FILE`) when a version is released.

  The compiler's warnings cover only calls. This check reads the debug information of every compiled module, which
  also contains struct literals (`%Sibling{}`) and module names passed as values. The exit status is 0 if there are
  no violations. Otherwise it is 1, and each violation is printed on one line.
  """
  use Mix.Task

  alias Situ.Build.{
    Architecture,
    Commits,
    Cycles,
    Decisions,
    DocLinks,
    Layers,
    Limits,
    ModuleDocs,
    PublicModules,
    Signatures,
    Sources
  }

  @impl Mix.Task
  def run(arguments) do
    lib = Path.join(Mix.Project.build_path(), "lib")

    case OptionParser.parse!(arguments, strict: [write_signatures: :boolean]) do
      {[], []} -> check_all(lib)
      {[write_signatures: true], path} -> write_signatures(lib, path)
    end
  end

  defp write_signatures(lib, path),
    do: Signatures.write_file(File.cwd!(), lib, project_version(), List.first(path))

  defp project_version, do: Mix.Project.config()[:version]

  defp check_all(lib) do
    modules = Architecture.read_modules(lib)

    problems =
      Architecture.find_violations(modules) ++
        Architecture.undeclared_deps(declared_deps()) ++
        Layers.find_violations(modules.situ) ++
        find_cycles(modules) ++
        rust_cycles("native") ++
        PublicModules.find_violations(File.cwd!(), lib, Map.keys(modules)) ++
        Signatures.find_violations(File.cwd!(), lib, project_version()) ++
        find_unknown_names(lib) ++
        check_sources(File.cwd!())

    report_layers(modules)

    if problems != [] do
      Enum.each(problems, fn problem -> Mix.shell().error(problem) end)
      Mix.raise("#{length(problems)} violation(s); see docs/ARCHITECTURE.md and CONTRIBUTING.md")
    end

    Mix.shell().info("architecture: every edge is allowed, 0 cycles")
  end

  # The page on upgrading names functions of earlier versions.
  defp find_unknown_names(lib) do
    names = "docs/api.md" |> File.read!() |> PublicModules.parse_list() |> Map.keys()
    modules = ModuleDocs.read_all(lib, Enum.sort(names))

    guides =
      for path <- Path.wildcard("docs/**/*.md") -- ["docs/upgrading.md"],
          do: {path, File.read!(path)}

    docs =
      for module <- modules,
          text <- ModuleDocs.list_texts(module),
          do: {"the documentation of #{module.name}", text}

    modules |> DocLinks.new(%{}, "") |> DocLinks.find_unknown(guides ++ docs)
  end

  defp check_sources(root) do
    Sources.find_violations(root) ++
      Limits.find_violations(root) ++
      Decisions.find_violations(root) ++ Commits.find_violations(root)
  end

  defp find_cycles(modules) do
    for {app, beams} <- modules, cycle <- Cycles.find_in_modules(beams) do
      "#{app}: #{length(cycle)} modules call each other in a cycle: #{Enum.map_join(cycle, ", ", &inspect/1)}"
    end
  end

  defp rust_cycles(workspace) do
    for src <- Path.wildcard(Path.join(workspace, "*/src")), cycle <- Cycles.find_in_crate(src) do
      "#{Path.dirname(src)}: #{length(cycle)} modules use each other in a cycle: #{Enum.join(cycle, ", ")}"
    end
  end

  defp report_layers(modules) do
    count = modules |> Map.values() |> Enum.map(&length/1) |> Enum.sum()

    layers =
      Enum.map_join(Layers.count_modules(modules.situ), " < ", fn {name, n} ->
        "#{name} (#{n})"
      end)

    Mix.shell().info("architecture: #{count} modules; layers of the runtime: #{layers}")
  end

  defp declared_deps do
    for {app, path} <- Mix.Project.apps_paths(), into: %{} do
      deps =
        Mix.Project.in_project(app, path, fn _ ->
          for {dep, opts} <- Mix.Project.config()[:deps], opts[:in_umbrella], do: dep
        end)

      {app, deps}
    end
  end
end

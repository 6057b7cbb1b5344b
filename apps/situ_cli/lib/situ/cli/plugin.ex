defmodule Situ.CLI.Plugin do
  @moduledoc false
  # `situ plugin`: creates, lists and tests plug-ins.
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Option, Output, Verb}
  alias Situ.Error
  alias Situ.Studio.Plugins
  alias Situ.Studio.Plugins.Template

  @impl true
  def verbs do
    [
      %Verb{
        words: ["plugin", "new"],
        summary:
          "create a working plug-in to start from: a visualizer, an adapter and their tests",
        about: """
        Creates the folder NAME with a plug-in that works. `situ studio --plugins NAME` finds it there. If it is in the
        folder that `situ plugin list` shows, it is found everywhere.
        """,
        arguments: [name: [kind: :text, doc: "its name: lowercase letters, digits and hyphens"]],
        options: [
          Option.new(:in, :path, "the folder to create it in (default: the current one)",
            value: "FOLDER"
          )
        ],
        examples: ["situ plugin new gaze-heat-map"],
        run: &create_plugin/2
      },
      %Verb{
        words: ["plugin", "list"],
        summary: "list the plug-ins, with the errors of broken ones",
        about: "Searches #{Plugins.default_dir()} and the FOLDERS for plug-ins.",
        arguments: [
          folders: [
            kind: :folder,
            optional: true,
            many: true,
            doc: "more folders that contain plug-ins or are plug-ins"
          ]
        ],
        examples: ["situ plugin list", "situ plugin list gaze-heat-map"],
        run: &list_plugins/2
      },
      %Verb{
        words: ["plugin", "test"],
        summary: "run the tests of a plug-in",
        about: """
        Loads the plug-in and runs its test/*_test.exs, then its test/*_test.mjs if Node is installed. Exits with
        status 1 if a test fails or the plug-in is broken.
        """,
        arguments: [folder: [kind: :folder, doc: "the plug-in"]],
        examples: ["situ plugin test gaze-heat-map"],
        run: &test_plugin/2
      }
    ]
  end

  @doc "Loads the plug-ins of the user's folder and of `folders`, registers them, and warns about broken ones."
  @spec load_plugins([Path.t()]) :: [Plugins.Plugin.t()]
  def load_plugins(folders) do
    plugins = Plugins.load([Plugins.default_dir() | folders])
    Plugins.register_modules(plugins)

    for %{problem: what} = plugin when what != nil <- plugins,
        do: Output.warn("situ: the plug-in #{plugin.id} is broken: #{what}")

    plugins
  end

  defp create_plugin(%{name: name}, opts) do
    case Template.write(name, opts[:in] || ".") do
      {:ok, folder, files} ->
        for file <- files, do: Output.puts("  " <> Path.join(folder, file))
        Output.puts("Try it: situ studio RECORDING --plugins #{folder}")
        0

      {:error, error} ->
        raise error
    end
  end

  defp list_plugins(%{folders: folders}, opts) do
    plugins = Plugins.load([Plugins.default_dir() | folders || []])

    cond do
      opts[:json] ->
        Output.print_json(Enum.map(plugins, &plugin_json/1))

      plugins == [] ->
        Output.puts("No plug-ins found. Put them in #{Plugins.default_dir()}.")

      true ->
        for plugin <- plugins, line <- describe_plugin(plugin), do: Output.puts(line)
    end

    if Enum.any?(plugins, & &1.problem), do: 1, else: 0
  end

  defp describe_plugin(plugin) do
    head = "#{plugin.id}  #{plugin.title}  (#{plugin.folder})"
    parts = for v <- plugin.visualizers, do: "    visualizer #{v.id}: #{v.title}"
    modules = for module <- plugin.modules, do: "    module #{inspect(module)}"
    [head | if(plugin.problem, do: ["    broken: #{plugin.problem}"], else: parts ++ modules)]
  end

  defp plugin_json(plugin) do
    %{
      id: plugin.id,
      title: plugin.title,
      folder: plugin.folder,
      problem: plugin.problem,
      visualizers: Enum.map(plugin.visualizers, & &1.id),
      modules: Enum.map(plugin.modules, &inspect/1)
    }
  end

  defp test_plugin(%{folder: folder}, _opts) do
    {:ok, _} = Application.ensure_all_started(:situ_studio)

    case Plugins.plugin(folder) do
      %{problem: nil} = plugin ->
        if run_elixir_tests(plugin.folder) and run_script_tests(plugin.folder), do: 0, else: 1

      plugin ->
        raise Error.new(:bad_plugin, "the plug-in #{plugin.id} is broken: #{plugin.problem}")
    end
  end

  defp run_elixir_tests(folder) do
    case folder |> Path.join("test/**/*_test.exs") |> Path.wildcard() do
      [] ->
        true

      files ->
        ExUnit.start(autorun: false)
        Enum.each(files, &Code.require_file/1)
        ExUnit.run().failures == 0
    end
  end

  defp run_script_tests(folder) do
    files = folder |> Path.join("test/**/*_test.mjs") |> Path.wildcard()
    node = System.find_executable("node")

    cond do
      files == [] ->
        true

      node == nil ->
        Output.warn("situ: Node is not installed, so the tests of the scripts were skipped")
        true

      true ->
        {text, status} = System.cmd(node, ["--test" | files], stderr_to_stdout: true)
        Output.puts(text)
        status == 0
    end
  end
end

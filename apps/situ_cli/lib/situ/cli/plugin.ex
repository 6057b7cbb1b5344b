defmodule Situ.CLI.Plugin do
  @moduledoc "`situ plugin`: what others add to Situ."
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
        summary: "make a plug-in: a visualizer, an adapter and their tests, to begin with",
        about: """
        Makes the folder NAME with a plug-in that works. It is found by `situ studio --plugins NAME`, and everywhere
        once it lies in the folder that `situ plugin list` shows.
        """,
        arguments: [name: [kind: :text, doc: "its name: small letters, digits and dashes"]],
        options: [
          Option.new(:in, :path, "the folder to make it in (default: here)", value: "FOLDER")
        ],
        examples: ["situ plugin new gaze-heat-map"],
        run: &new/2
      },
      %Verb{
        words: ["plugin", "list"],
        summary: "list the plug-ins, with the errors of broken ones",
        about: "Plug-ins are looked for in #{Plugins.default_dir()} and in the FOLDERS.",
        arguments: [
          folders: [
            kind: :folder,
            optional: true,
            many: true,
            doc: "further folders of plug-ins, or of one"
          ]
        ],
        examples: ["situ plugin list", "situ plugin list gaze-heat-map"],
        run: &list/2
      },
      %Verb{
        words: ["plugin", "test"],
        summary: "run the tests of a plug-in",
        about: """
        Loads the plug-in and runs its test/*_test.exs, then its test/*_test.mjs with Node where that is installed.
        Status 1 where one fails, or the plug-in is broken.
        """,
        arguments: [folder: [kind: :folder, doc: "the plug-in"]],
        examples: ["situ plugin test gaze-heat-map"],
        run: &test/2
      }
    ]
  end

  @doc "The plug-ins of the user's folder and of `folders`, their readers and tasks made known. Warns of broken ones."
  @spec load([Path.t()]) :: [Plugins.Plugin.t()]
  def load(folders) do
    plugins = Plugins.load([Plugins.default_dir() | folders])
    Plugins.register(plugins)

    for %{problem: what} = plugin when what != nil <- plugins,
        do: Output.warn("situ: the plug-in #{plugin.id} is broken: #{what}")

    plugins
  end

  defp new(%{name: name}, opts) do
    case Template.write(name, opts[:in] || ".") do
      {:ok, folder, files} ->
        for file <- files, do: Output.puts("  " <> Path.join(folder, file))
        Output.puts("Look at it: situ studio RECORDING --plugins #{folder}")
        0

      {:error, error} ->
        raise error
    end
  end

  defp list(%{folders: folders}, opts) do
    plugins = Plugins.load([Plugins.default_dir() | folders || []])

    cond do
      opts[:json] ->
        Output.json(Enum.map(plugins, &json/1))

      plugins == [] ->
        Output.puts("There are no plug-ins. They lie in #{Plugins.default_dir()}.")

      true ->
        for plugin <- plugins, line <- lines(plugin), do: Output.puts(line)
    end

    if Enum.any?(plugins, & &1.problem), do: 1, else: 0
  end

  defp lines(plugin) do
    head = "#{plugin.id}  #{plugin.title}  (#{plugin.folder})"
    parts = for v <- plugin.visualizers, do: "    visualizer #{v.id}: #{v.title}"
    modules = for module <- plugin.modules, do: "    module #{inspect(module)}"
    [head | if(plugin.problem, do: ["    broken: #{plugin.problem}"], else: parts ++ modules)]
  end

  defp json(plugin) do
    %{
      id: plugin.id,
      title: plugin.title,
      folder: plugin.folder,
      problem: plugin.problem,
      visualizers: Enum.map(plugin.visualizers, & &1.id),
      modules: Enum.map(plugin.modules, &inspect/1)
    }
  end

  defp test(%{folder: folder}, _opts) do
    {:ok, _} = Application.ensure_all_started(:situ_studio)

    case Plugins.plugin(folder) do
      %{problem: nil} = plugin ->
        if elixir(plugin.folder) and scripts(plugin.folder), do: 0, else: 1

      plugin ->
        raise Error.new(:bad_plugin, "the plug-in #{plugin.id} is broken: #{plugin.problem}")
    end
  end

  defp elixir(folder) do
    case folder |> Path.join("test/**/*_test.exs") |> Path.wildcard() do
      [] ->
        true

      files ->
        ExUnit.start(autorun: false)
        Enum.each(files, &Code.require_file/1)
        ExUnit.run().failures == 0
    end
  end

  defp scripts(folder) do
    files = folder |> Path.join("test/**/*_test.mjs") |> Path.wildcard()
    node = System.find_executable("node")

    cond do
      files == [] ->
        true

      node == nil ->
        Output.warn("situ: Node is not installed: the tests of the scripts did not run")
        true

      true ->
        {text, status} = System.cmd(node, ["--test" | files], stderr_to_stdout: true)
        Output.puts(text)
        status == 0
    end
  end
end

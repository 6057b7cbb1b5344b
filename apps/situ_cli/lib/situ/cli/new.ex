defmodule Situ.CLI.New do
  @moduledoc false
  # `situ new`: creates a project that uses this Situ, or adds a component, a visualizer or a task to a project.
  @behaviour Situ.CLI.Verb

  alias Situ.CLI.{Checkout, Option, Output, Verb}
  alias Situ.CLI.New.{Example, Name, Template}
  alias Situ.Error
  alias Situ.Studio.Plugins

  @impl true
  def verbs do
    [
      %Verb{
        words: ["new"],
        summary: "create a project with a pipeline, a component and tests",
        about: """
        Creates a Mix project in the folder PATH. It uses this Situ without compiling it again, and contains a pipeline
        that runs, a component, tests on a virtual clock, a layout for the studio and a release with a systemd unit.

        --example copies an example instead, and gives it the project's name. The examples are
        #{Enum.join(Example.list_names(), ", ")}.

        With --component, --task or --visualizer, adds a working example to the project in the current folder instead.
        """,
        arguments: [
          path: [
            kind: :text,
            optional: true,
            doc: "the folder; its last part is the project's name"
          ]
        ],
        options: [
          Option.new(:umbrella, :flag, "create an umbrella project with one application"),
          Option.new(:example, :string, "copy this example", value: "NAME"),
          Option.new(:component, :string, "add a component and its test", value: "NAME"),
          Option.new(:task, :string, "add a batch task for datasets", value: "NAME"),
          Option.new(:visualizer, :string, "add a plug-in for the studio", value: "NAME")
        ],
        examples: [
          "situ new lobby",
          "situ new minutes --example meeting_room",
          "situ new --component blink-detector"
        ],
        run: &create/2
      }
    ]
  end

  defp create(%{path: path}, opts) do
    case {path, for(kind <- [:component, :task, :visualizer], opts[kind], do: {kind, opts[kind]})} do
      {nil, []} -> throw({:usage, "PATH is missing (the folder of the new project)"})
      {nil, [{kind, name}]} -> add_part(kind, name)
      {path, []} -> create_project(path, opts)
      {nil, _several} -> throw({:usage, "give one of --component, --task and --visualizer"})
      {path, _part} -> throw({:usage, "a part is added to the current folder; leave out #{path}"})
    end
  end

  defp create_project(path, opts) do
    path = Path.expand(path)
    name = Error.unwrap!(Name.parse(Path.basename(path)))

    if File.exists?(path) and File.ls(path) != {:ok, []} do
      raise Error.new(:exists, "#{path} already exists", fix: "choose another folder")
    end

    files = project_files(name, opts)
    Error.unwrap!(Template.write(files, path))
    for {file, _} <- files, do: Output.puts("  " <> Path.join(Path.relative_to_cwd(path), file))
    Output.puts(next_steps(path, name, opts))
    0
  end

  defp project_files(name, opts) do
    case {opts[:example], opts[:umbrella]} do
      {nil, true} -> Template.umbrella_files(name, Checkout.folder())
      {nil, _} -> Template.project_files(name, Checkout.folder())
      {_example, true} -> throw({:usage, "give either --umbrella or --example"})
      {example, _} -> Error.unwrap!(Example.project_files(example, name, Checkout.folder()))
    end
  end

  defp next_steps(path, name, opts) do
    folder = Path.relative_to_cwd(path)
    project = if opts[:umbrella], do: "#{folder}/apps/#{name.file}", else: folder

    """

    Your project is ready. Try it:

      cd #{project}
      situ run              # runs the pipeline; Ctrl-C stops it
      situ run --studio     # shows it in the browser
      mix test
    #{path_hint()}#{elixir_hint()}\
    """
  end

  # An unpacked release runs files without Elixir, but Mix compiles projects.
  defp elixir_hint do
    if System.find_executable("mix"),
      do: "",
      else: "\nProjects need Elixir, which is not installed: sudo apt install elixir\n"
  end

  # The commands above work only if `situ` is on the PATH.
  defp path_hint do
    if System.find_executable("situ"),
      do: "",
      else: "\n`situ` is not on your PATH: export PATH=#{Checkout.folder()}/bin:$PATH\n"
  end

  @doc "Adds a part to the project in the current folder, and prints its files. Returns the exit status."
  @spec add_part(:component | :task | :visualizer, String.t()) :: 0
  def add_part(:visualizer, name) do
    check_project()

    case Plugins.Template.write(name, "visualizers") do
      {:ok, folder, files} ->
        for file <- files, do: Output.puts("  " <> Path.join(folder, file))
        Output.puts("Try it: situ studio recordings --plugins visualizers")
        0

      {:error, error} ->
        raise error
    end
  end

  def add_part(kind, text) do
    project = check_project()
    name = Error.unwrap!(Name.parse(text))
    files = Template.part_files(kind, name, project)
    Error.unwrap!(Template.write(files, "."))
    for {file, _} <- files, do: Output.puts("  " <> file)
    Output.puts(part_hint(kind, name, project))
    0
  end

  defp part_hint(:component, name, project),
    do: "Use it: Situ.via(stream, #{project.module}.#{name.module}). Test it: mix test"

  defp part_hint(:task, name, project),
    do: "Run it: situ task run DATASET lib/#{project.file}/#{name.file}.ex --set stream=NAME"

  # The name of the project in the current folder, as its mix.exs gives it.
  defp check_project do
    with {:ok, text} <- File.read("mix.exs"),
         [_, app] <- Regex.run(~r/\bapp: :([a-z][a-z0-9_]*)/, text),
         {:ok, name} <- Name.parse(app) do
      name
    else
      _ ->
        raise Error.new(:no_project, "the current folder is not the folder of an application",
                why: "it has no mix.exs with `app:`",
                fix: "change to the project's folder, or create one with `situ new PATH`"
              )
    end
  end
end

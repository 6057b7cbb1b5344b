defmodule Situ.CLI.New.Template do
  @moduledoc false
  # The files of a new project, of an umbrella project, and of parts of a project. They are made from the templates in
  # `priv`: names in double braces are replaced, the file name `APP` becomes the project's name, and the prefix `dot-`
  # becomes a dot. See docs/adr/0002-projects-use-the-compiled-situ.md.
  alias Situ.CLI.New.Name
  alias Situ.Error
  alias Situ.Studio.Plugins

  @type files :: [{Path.t(), String.t()}]

  # An application of an umbrella shares these folders and files with the others.
  @umbrella_paths """
        build_path: "../../_build",
        config_path: "../../config/config.exs",
        deps_path: "../../deps",
        lockfile: "../../mix.lock",
  """

  @doc "Returns the files of a project that uses the Situ in the folder `situ`."
  @spec project_files(Name.t(), Path.t()) :: files()
  def project_files(%Name{} = name, situ), do: read_files("project", bindings(name, situ, ""))

  @doc "Returns the files of an umbrella project with one application."
  @spec umbrella_files(Name.t(), Path.t()) :: files()
  def umbrella_files(%Name{} = name, situ) do
    {shared, own} =
      "project"
      |> read_files(bindings(name, situ, @umbrella_paths))
      |> Enum.split_with(fn {path, _} -> shared?(path) end)

    own = for {path, text} <- own, do: {Path.join(["apps", name.file, path]), text}
    read_files("umbrella", bindings(name, situ, "")) ++ shared ++ own
  end

  defp shared?(path), do: path == ".gitignore" or String.starts_with?(path, ["config/", "rel/"])

  @doc "Returns the files of a component or a task in the application `project`."
  @spec part_files(:component | :task, Name.t(), Name.t()) :: files()
  def part_files(kind, %Name{} = name, %Name{} = project) do
    path = Path.join(project.file, name.file)

    bindings = %{
      "Module" => "#{project.module}.#{name.module}",
      "Last" => name.module,
      "path" => path,
      "name" => String.replace(name.file, "_", "-")
    }

    for {source, target} <- part_targets(kind, path),
        do: {target, "parts" |> template_path(source) |> File.read!() |> fill_in(bindings)}
  end

  defp part_targets(:component, path),
    do: [{"component.ex", "lib/#{path}.ex"}, {"component_test.exs", "test/#{path}_test.exs"}]

  defp part_targets(:task, path), do: [{"task.ex", "lib/#{path}.ex"}]

  @doc "Writes files below `folder`, or none if a file exists already. Errors: `:exists`, `:not_saved`."
  @spec write(files(), Path.t()) :: :ok | {:error, Error.t()}
  def write(files, folder) do
    case Enum.find(files, fn {path, _} -> File.exists?(Path.join(folder, path)) end) do
      nil ->
        Plugins.Template.write_files(folder, files)

      {path, _} ->
        {:error, Error.new(:exists, "#{path} already exists", fix: "choose another name")}
    end
  end

  defp bindings(name, situ, umbrella_paths) do
    %{
      "app" => name.file,
      "APP" => String.upcase(name.file),
      "Module" => name.module,
      "situ" => situ,
      "umbrella_paths" => umbrella_paths
    }
  end

  defp read_files(template, bindings) do
    root = template_path(template, "")

    for path <- root |> Path.join("**") |> Path.wildcard() |> Enum.sort(), File.regular?(path) do
      {path |> Path.relative_to(root) |> target_path(bindings["app"]),
       path |> File.read!() |> fill_in(bindings)}
    end
  end

  defp target_path(path, app),
    do: path |> String.replace("APP", app) |> String.replace_prefix("dot-", ".")

  defp fill_in(text, bindings) do
    Enum.reduce(bindings, text, fn {name, value}, text ->
      String.replace(text, "{{#{name}}}", value)
    end)
  end

  defp template_path(template, file),
    do: Path.join([:code.priv_dir(:situ_cli), template, file])
end

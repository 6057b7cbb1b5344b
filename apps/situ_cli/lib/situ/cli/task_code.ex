defmodule Situ.CLI.TaskCode do
  @moduledoc false
  # Loads the code of tasks for `situ task` and `situ dataset`. A dataset may come from somebody else, so a file is only
  # compiled if the user names it on the command line.
  alias Situ.CLI.{Output, SourceFile}
  alias Situ.Dataset
  alias Situ.Error
  alias Situ.Experiment.TaskProvenance

  @apps [:situ_dataset, :situ_media, :situ_infer]

  @doc "Loads a task by its name or from its file, with the modules of the file: `{{module, binaries}, task}`."
  @spec load_task!(String.t()) :: {TaskProvenance.task(), map()}
  def load_task!(name) do
    if file?(name) do
      load_from_file(name)
    else
      module = Error.unwrap!(Dataset.Task.fetch_task(name))
      {{module, %{}}, module.task()}
    end
  end

  @doc "Returns whether the name of a task is a file."
  @spec file?(String.t()) :: boolean()
  def file?(name), do: Path.extname(name) in [".ex", ".exs"]

  @doc "Starts the applications that have tasks."
  @spec start_apps() :: :ok
  def start_apps do
    for app <- @apps, do: {:ok, _} = Application.ensure_all_started(app)
    :ok
  end

  defp load_from_file(file) do
    binaries = file |> SourceFile.compile_file!() |> Map.new()
    modules = Map.keys(binaries)

    cond do
      module = Enum.find(modules, &function_exported?(&1, :task, 0)) ->
        {{module, binaries}, module.task()}

      module = Enum.find(modules, &function_exported?(&1, :build, 2)) ->
        {{module, binaries}, %{output: module |> Module.split() |> List.last(), options: []}}

      true ->
        raise Error.new(:no_task, "#{file} has no task and no pipeline",
                fix: "define a module with build/2, see Situ.Dataset.derive/3"
              )
    end
  end

  @doc "Returns the partitions of a dataset that are outdated. `tasks` are loaded tasks by the names of their files."
  @spec list_outdated(Dataset.t(), %{String.t() => {TaskProvenance.task(), map()}}) ::
          [TaskProvenance.entry()]
  def list_outdated(dataset, tasks \\ %{}) do
    start_apps()
    TaskProvenance.list_outdated(dataset, &find_task(&1, tasks))
  end

  defp find_task(name, tasks) do
    cond do
      is_map_key(tasks, name) -> {:ok, elem(tasks[name], 0)}
      file?(name) -> {:error, :unknown}
      true -> with {:ok, module} <- Dataset.Task.fetch_task(name), do: {:ok, {module, %{}}}
    end
  end

  @doc "Prints a partition that is outdated, and why."
  @spec print_entry(TaskProvenance.entry()) :: :ok
  def print_entry(entry) do
    why = Enum.map_join(entry.changes, ", ", &describe_change/1)

    Output.puts(
      "#{Output.format_name(entry.session)}, #{entry.partition} (#{entry.task}): #{why}"
    )
  end

  defp describe_change(:code), do: "the code has changed"
  defp describe_change(:inputs), do: "the recordings have changed"
  defp describe_change(:no_task), do: "the task does not exist here"
end

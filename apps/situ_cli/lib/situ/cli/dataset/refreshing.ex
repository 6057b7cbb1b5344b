defmodule Situ.CLI.Dataset.Refreshing do
  @moduledoc false
  # `situ dataset refresh`: makes partitions of tasks again whose code or inputs have changed since. A dataset file may
  # come from somebody else, so the file of a task is only compiled if the user names it.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, TaskCode, Verb}
  alias Situ.CLI.Task, as: TaskRun
  alias Situ.Dataset.Derivation.Report
  alias Situ.Error
  alias Situ.Experiment.TaskProvenance

  @impl true
  def verbs do
    [
      %Verb{
        words: ["dataset", "refresh"],
        summary: "make partitions of tasks again whose code or recordings have changed",
        about: """
        A partition knows the task, the options, the code and the recordings that made it. This compares them with the
        present and runs the task again, with the same options, where they differ. The earlier recordings are not
        deleted. Changes of annotations do not count. If a task is an Elixir file, name it with --code; the file is
        compiled and run without restrictions.
        """,
        arguments: [path: [kind: :recording, doc: "a dataset file"]],
        options: [
          Option.new(:dry_run, :flag, "only list the partitions"),
          Option.new(:session, :string, "only this session", many?: true, value: "NAME"),
          Option.new(:code, :path, "the Elixir file of a task", many?: true, value: "FILE")
        ],
        examples: [
          "situ dataset refresh study.json --dry-run",
          "situ dataset refresh study.json --code loudness.ex"
        ],
        run: &refresh_dataset/2
      }
    ]
  end

  defp refresh_dataset(%{path: path}, opts) do
    TaskCode.start_apps()
    dataset = Situ.CLI.Dataset.open_dataset!(path)
    tasks = Map.new(opts[:code] || [], &{Path.basename(&1), TaskCode.load_task!(&1)})
    entries = list_outdated(dataset, tasks, opts)

    cond do
      opts[:json] && opts[:dry_run] -> Output.print_json(entries)
      entries == [] -> Output.puts("All partitions of tasks are up to date.")
      true -> Enum.each(entries, &TaskCode.print_entry/1)
    end

    warn_unknown(dataset, tasks)
    if opts[:dry_run] or entries == [], do: 0, else: run_groups(dataset, {tasks, []}, opts)
  end

  defp list_outdated(dataset, tasks, opts) do
    for entry <- TaskCode.list_outdated(dataset, tasks),
        opts[:session] in [nil, []] or entry.session in opts[:session],
        do: entry
  end

  defp warn_unknown(dataset, tasks) do
    names =
      for entry <- TaskProvenance.list_entries(dataset, fn _ -> {:error, :unknown} end),
          TaskCode.file?(entry.task) and not is_map_key(tasks, entry.task),
          uniq: true,
          do: entry.task

    for name <- names, do: Output.warn("The code of #{name} was not compared: give --code FILE.")
  end

  # A partition can be the input of another one, so the list is made again after each run.
  defp run_groups(dataset, {tasks, done}, opts) do
    case next_group(list_outdated(dataset, tasks, opts), done) do
      nil ->
        if Enum.any?(done, fn {_, ok?} -> not ok? end), do: 1, else: 0

      {key, entries} ->
        {dataset, ok?} = run_group(dataset, {key, entries, tasks}, opts)
        run_groups(dataset, {tasks, [{key, ok?} | done]}, opts)
    end
  end

  defp next_group(entries, done) do
    entries
    |> Enum.group_by(&{&1.task, &1.partition, &1.options})
    |> Enum.sort_by(fn {_, entries} -> entries |> Enum.map(& &1.at) |> Enum.min() end)
    |> Enum.find(fn {key, entries} ->
      not List.keymember?(done, key, 0) and not Enum.any?(entries, &(:no_task in &1.changes))
    end)
  end

  defp run_group(dataset, {{name, output, options}, entries, tasks}, opts) do
    sessions = Enum.map(entries, & &1.session)

    case fetch_code(name, tasks) do
      {:ok, {{module, _} = code, task}} ->
        options = Error.unwrap!(Situ.Options.parse(options, task.options))

        derivation = [
          output: output,
          options: options,
          overwrite: true,
          resume: false,
          sessions: sessions,
          provenance: TaskProvenance.describe_runs(name, code, options, output)
        ]

        {:ok, dataset, report} = TaskRun.derive_dataset(dataset, module, derivation, opts)
        TaskRun.print_report(dataset, report)
        {dataset, Report.failures(report) == []}

      :unknown ->
        {dataset, false}
    end
  end

  defp fetch_code(name, tasks) do
    cond do
      is_map_key(tasks, name) -> {:ok, tasks[name]}
      TaskCode.file?(name) -> :unknown
      true -> {:ok, TaskCode.load_task!(name)}
    end
  end
end

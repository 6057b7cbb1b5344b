defmodule Situ.CLI.Task do
  @moduledoc false
  # `situ task` and `situ dataset run`: run batch tasks and pipelines over the sessions of a
  # dataset.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, Progress, Setting, TaskCode, Verb}
  alias Situ.Dataset
  alias Situ.Dataset.Derivation.Report
  alias Situ.Experiment.TaskProvenance
  alias Situ.{Error, Time}

  @impl true
  def verbs do
    run = run_verb()

    [
      %Verb{
        words: ["task", "list"],
        aliases: ["tasks"],
        summary: "list all tasks, with their options",
        examples: ["situ task list"],
        run: &list_tasks/2
      },
      run,
      %{
        run
        | words: ["dataset", "run"],
          aliases: [],
          examples:
            for(example <- run.examples, do: String.replace(example, "task run", "dataset run"))
      }
    ]
  end

  defp run_verb do
    %Verb{
      words: ["task", "run"],
      aliases: ["exec"],
      summary: "run a task, or your own pipeline, over the sessions of a dataset",
      about: """
      A session that fails does not stop the others (status 1 at the end). The same command resumes a run that was
      stopped or killed. Recordings are never changed: a task creates a new partition or a file. TASK can also be an
      Elixir file with a module that is a task (Situ.Dataset.Task) or a pipeline (Situ.Dataset.derive/3). The file is
      compiled and run without restrictions, so use only files that you trust.
      """,
      arguments: [
        path: [kind: :recording, doc: "a dataset file, a folder of recordings, or a recording"],
        task: [kind: :text, doc: "the task's name, or FILE.ex"]
      ],
      options: [
        Option.new(:set, :string, "an option of the task; VALUE is JSON or text",
          value: "NAME=VALUE",
          many?: true
        ),
        Option.new(:config, :path, "a JSON file with the options of the task", value: "FILE"),
        Option.new(:save_config, :path, "write the options to a file, for --config", value: "FILE"),
        Option.new(:session, :string, "only this session", many?: true, value: "NAME"),
        Option.new(:output, :string, "the new partition's name", value: "NAME"),
        Option.new(:overwrite, :flag, "replace an existing partition of that name"),
        Option.new(:parallel, :integer, "the number of sessions to process in parallel",
          default: 1
        ),
        Option.new(:stop, :flag, "stop at the first session that fails")
      ],
      examples: [
        "situ task run study.json sound-to-wav --set stream=Mic",
        "situ task run study.json voice-activity --parallel 2",
        "situ task run study.json loudness.ex --output Loudness"
      ],
      run: &run_task/2
    }
  end

  defp list_tasks(_arguments, opts) do
    TaskCode.start_apps()
    tasks = Enum.map(Dataset.Task.list_tasks(), & &1.task())

    if opts[:json] do
      Output.print_json(
        for task <- tasks, do: %{task | options: Enum.map(task.options, &describe_option/1)}
      )
    else
      for task <- tasks do
        Output.puts("#{task.name}  #{task.about}")

        for line <- Setting.describe_options(task.options), do: Output.puts("    " <> line)
      end
    end

    0
  end

  defp describe_option({name, spec}) do
    default = spec[:default]
    %{name: name, doc: spec[:doc], required: spec[:required] == true, default: default}
  end

  defp run_task(%{path: path, task: name}, opts) do
    TaskCode.start_apps()
    {{module, _} = code, task} = TaskCode.load_task!(name)
    config = load_config(opts)
    options = unwrap!(Situ.Options.parse(config, task.options))
    if opts[:save_config], do: save_config(opts[:save_config], options)
    dataset = Situ.CLI.Dataset.open_dataset!(path)

    {:ok, dataset, report} =
      derive_dataset(dataset, module, derivation_options({name, code, task}, options, opts), opts)

    if opts[:json],
      do: Output.print_json(report_json(report)),
      else: print_report(dataset, report)

    if Report.failures(report) == [], do: 0, else: 1
  end

  # The name of a file is stored without its folder, because a dataset must not say which file is run.
  defp derivation_options({name, code, task}, options, opts) do
    output = if task.output, do: opts[:output] || task.output
    name = if TaskCode.file?(name), do: Path.basename(name), else: name

    [
      output: output,
      options: options,
      provenance: if(output, do: TaskProvenance.describe_runs(name, code, options, output)),
      overwrite: opts[:overwrite],
      parallel: max(opts[:parallel], 1),
      on_failure: if(opts[:stop], do: :stop, else: :continue)
    ]
    |> Enum.reject(&(&1 == {:provenance, nil}))
    |> Enum.concat(if(opts[:session] == [], do: [], else: [sessions: opts[:session]]))
  end

  @doc "Runs a task over a dataset and shows the progress. Raises the error of `Situ.Dataset.derive/3`."
  @spec derive_dataset(Dataset.t(), module(), keyword(), keyword()) ::
          {:ok, Dataset.t(), Report.t()}
  def derive_dataset(dataset, module, derivation, opts) do
    Progress.with_progress("run", opts, fn progress ->
      report_progress = &progress.(round(&1.done * 1_000), 1_000)

      case Dataset.derive(dataset, module, [{:progress, report_progress} | derivation]) do
        {:ok, dataset, report} -> {:ok, dataset, report}
        {:error, error} -> raise error
      end
    end)
  end

  # Options from --set override options from the file.
  defp load_config(opts) do
    saved = if opts[:config], do: read_config(opts[:config]), else: %{}

    Enum.into(Setting.parse_settings(opts[:set]), saved)
  end

  defp read_config(path) do
    with {:ok, text} <- File.read(path), {:ok, %{} = config} <- Situ.JSON.decode(text) do
      config
    else
      _ ->
        raise Error.new(:bad_config, "#{path} is not a task configuration",
                fix: "write a JSON object with the task's options"
              )
    end
  end

  defp save_config(path, options) do
    case File.write(path, Situ.JSON.encode_pretty(Map.new(options)) <> "\n") do
      :ok ->
        :ok

      {:error, reason} ->
        raise Error.new(:not_saved, "cannot write #{path}",
                why: to_string(:file.format_error(reason))
              )
    end
  end

  @doc "Prints the result of each session."
  @spec print_report(Dataset.t(), Report.t()) :: :ok
  def print_report(dataset, report) do
    for result <- report.results do
      what =
        if result.error,
          do: "failed: #{Exception.message(result.error)}",
          else: to_string(result.status)

      Output.puts(
        "#{Output.format_name(result.session)}: #{what} (#{Time.format_duration(result.took)})"
      )
    end

    if report.output && dataset.file == nil && Enum.any?(report.results, &(&1.error == nil)),
      do:
        Output.warn(
          "The partitions #{inspect(report.output)} were written; run `situ dataset create` on the folder to list them."
        )

    :ok
  end

  defp report_json(report) do
    results =
      for r <- report.results,
          do: %{
            session: r.session,
            status: r.status,
            took: r.took,
            error: r.error && r.error.what
          }

    %{output: report.output, duration: report.duration, results: results}
  end

  defp unwrap!({:ok, value}), do: value
  defp unwrap!({:error, error}), do: raise(error)
end

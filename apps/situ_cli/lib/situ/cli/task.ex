defmodule Situ.CLI.Task do
  @moduledoc "`situ task`: batch tasks over the sessions of a dataset."
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, Progress, Verb}
  alias Situ.Dataset
  alias Situ.Dataset.Derivation.Report
  alias Situ.{Error, Time}

  @apps [:situ_dataset, :situ_media, :situ_infer]

  @impl true
  def verbs do
    [
      %Verb{
        words: ["task", "list"],
        aliases: ["tasks"],
        summary: "list all tasks, with their options",
        examples: ["situ task list"],
        run: &list/2
      },
      %Verb{
        words: ["task", "run"],
        aliases: ["exec"],
        summary: "run a task over the sessions of a dataset",
        about: """
        A session that fails does not stop the others (status 1 at the end). A run that was stopped or killed is
        taken up where it was by the same command. Recordings are never changed: a task makes a new partition, or a
        file.
        """,
        arguments: [
          path: [kind: :recording, doc: "a dataset file, a folder of recordings, or a recording"],
          task: [kind: :text, doc: "the task's name"]
        ],
        options: [
          Option.new(:set, :string, "an option of the task; VALUE is JSON, or text",
            value: "NAME=VALUE",
            many?: true
          ),
          Option.new(:config, :path, "options of the task, a JSON object", value: "FILE"),
          Option.new(:save_config, :path, "write the options to a file, for --config",
            value: "FILE"
          ),
          Option.new(:session, :string, "only this session", many?: true, value: "NAME"),
          Option.new(:output, :string, "the new partition's name", value: "NAME"),
          Option.new(:overwrite, :flag, "put it in the place of a partition of that name"),
          Option.new(:parallel, :integer, "so many sessions at once", default: 1),
          Option.new(:stop, :flag, "stop at the first session that fails")
        ],
        examples: [
          "situ task run study.json sound-to-wav --set stream=Mic",
          "situ task run study.json voice-activity --parallel 2"
        ],
        run: &run/2
      }
    ]
  end

  defp ready, do: for(app <- @apps, do: {:ok, _} = Application.ensure_all_started(app))

  defp list(_arguments, opts) do
    ready()
    tasks = Enum.map(Dataset.Task.all(), & &1.task())

    if opts[:json] do
      Output.json(for task <- tasks, do: %{task | options: Enum.map(task.options, &described/1)})
    else
      for task <- tasks do
        Output.puts("#{task.name}  #{task.about}")
        for option <- task.options, do: Output.puts("    " <> line(described(option)))
      end
    end

    0
  end

  defp described({name, spec}) do
    default = spec[:default]
    %{name: name, doc: spec[:doc], required: spec[:required] == true, default: default}
  end

  defp line(%{required: true} = option), do: "#{option.name}: #{option.doc} Required."
  defp line(option), do: "#{option.name}: #{option.doc} (default #{inspect(option.default)})"

  defp run(%{path: path, task: name}, opts) do
    ready()
    module = ok!(Dataset.Task.fetch(name))
    task = module.task()
    config = config(opts)
    options = ok!(Dataset.Task.options(task.options, config))
    if opts[:save_config], do: save(opts[:save_config], options)
    dataset = Situ.CLI.Dataset.open!(path)

    {:ok, dataset, report} = derived(dataset, module, derivation(task, options, opts), opts)
    if opts[:json], do: Output.json(json(report)), else: shown(dataset, report)
    if Report.failures(report) == [], do: 0, else: 1
  end

  defp derivation(task, options, opts) do
    output = if task.output, do: opts[:output] || task.output

    [
      output: output,
      options: options,
      overwrite: opts[:overwrite],
      parallel: max(opts[:parallel], 1),
      on_failure: if(opts[:stop], do: :stop, else: :continue)
    ] ++ if(opts[:session] == [], do: [], else: [sessions: opts[:session]])
  end

  defp derived(dataset, module, derivation, opts) do
    Progress.show("run", opts, fn progress ->
      told = &progress.(round(&1.done * 1_000), 1_000)

      case Dataset.derive(dataset, module, [{:progress, told} | derivation]) do
        {:ok, dataset, report} -> {:ok, dataset, report}
        {:error, error} -> raise error
      end
    end)
  end

  # What --set says goes before what the file says.
  defp config(opts) do
    saved = if opts[:config], do: read(opts[:config]), else: %{}

    Enum.reduce(opts[:set], saved, fn text, config ->
      case String.split(text, "=", parts: 2) do
        [name, value] -> Map.put(config, name, value(value))
        [_] -> throw({:usage, "--set takes NAME=VALUE, not #{inspect(text)}"})
      end
    end)
  end

  defp value(text) do
    case Situ.JSON.decode(text) do
      {:ok, value} -> value
      {:error, :bad_json} -> text
    end
  end

  defp read(path) do
    with {:ok, text} <- File.read(path), {:ok, %{} = config} <- Situ.JSON.decode(text) do
      config
    else
      _ ->
        raise Error.new(:bad_config, "#{path} is no configuration",
                fix: "it is a JSON object of the task's options"
              )
    end
  end

  defp save(path, options) do
    case File.write(path, Situ.JSON.pretty(Map.new(options)) <> "\n") do
      :ok ->
        :ok

      {:error, reason} ->
        raise Error.new(:not_saved, "cannot write #{path}",
                why: to_string(:file.format_error(reason))
              )
    end
  end

  defp shown(dataset, report) do
    for result <- report.results do
      what =
        if result.error,
          do: "failed: #{Exception.message(result.error)}",
          else: to_string(result.status)

      Output.puts(
        "#{Output.name(result.session)}: #{what} (#{Time.format_duration(result.took)})"
      )
    end

    if report.output && dataset.file == nil && Enum.any?(report.results, &(&1.error == nil)),
      do:
        Output.warn(
          "The partitions #{inspect(report.output)} are written; make a dataset of the folder to have them listed."
        )
  end

  defp json(report) do
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

  defp ok!({:ok, value}), do: value
  defp ok!({:error, error}), do: raise(error)
end

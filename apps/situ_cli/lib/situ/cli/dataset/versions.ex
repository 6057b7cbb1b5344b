defmodule Situ.CLI.Dataset.Versions do
  @moduledoc false
  # The verbs of `situ dataset` for the history of a dataset file.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{HistoryTable, Output, Verb}
  alias Situ.Dataset.History
  alias Situ.Error

  @file_argument [kind: :file, doc: "a dataset file"]

  @impl true
  def verbs do
    [
      %Verb{
        words: ["dataset", "history"],
        summary: "list who changed the dataset, when, and what",
        arguments: [file: @file_argument],
        options: [HistoryTable.limit_option()],
        examples: ["situ dataset history study.json"],
        run: &show_history/2
      },
      %Verb{
        words: ["dataset", "diff"],
        summary: "show the differences between two versions",
        about:
          "A version is a number from the history, a name given with `situ dataset name`, or `now`.",
        arguments: [
          file: @file_argument,
          before: HistoryTable.version_argument("the earlier version"),
          later: [kind: :text, optional: true, doc: "the later version (default: now)"]
        ],
        examples: ["situ dataset diff study.json 12", "situ dataset diff study.json paper now"],
        run: &show_differences/2
      },
      %Verb{
        words: ["dataset", "name"],
        summary: "give a version a name",
        arguments: [
          file: @file_argument,
          name: [kind: :text, doc: "the name"],
          version: [kind: :text, optional: true, doc: "the version (default: now)"]
        ],
        examples: ["situ dataset name study.json 'as published'"],
        run: &name_version/2
      },
      %Verb{
        words: ["dataset", "restore"],
        summary: "restore an earlier version, as a new operation that can be undone",
        arguments: [file: @file_argument, version: HistoryTable.version_argument("the version")],
        examples: ["situ dataset restore study.json 12"],
        run: &restore_version/2
      },
      %Verb{
        words: ["dataset", "undo"],
        summary: "undo your last edit of the dataset",
        arguments: [file: @file_argument],
        run: fn args, opts -> print_last(args.file, opts, &History.undo/1) end
      },
      %Verb{
        words: ["dataset", "redo"],
        summary: "redo the edit that you undid last",
        arguments: [file: @file_argument],
        run: fn args, opts -> print_last(args.file, opts, &History.redo/1) end
      }
    ]
  end

  defp open_dataset!(file), do: Situ.CLI.Dataset.open_dataset!(file)

  defp show_history(%{file: file}, opts),
    do:
      file
      |> open_dataset!()
      |> History.list()
      |> Error.unwrap!()
      |> HistoryTable.print_history(opts)

  defp show_differences(%{file: file, before: before, later: later}, opts) do
    lines = Error.unwrap!(History.diff(open_dataset!(file), before, later || "now"))
    HistoryTable.print_differences(lines, opts)
  end

  defp name_version(%{file: file, name: name, version: version}, opts),
    do: print_last(file, opts, &History.name_version(&1, name, version || "now"))

  defp restore_version(%{file: file, version: version}, opts),
    do: print_last(file, opts, &History.restore(&1, version))

  # Prints the operation that was added, if there is one.
  defp print_last(file, opts, fun) do
    dataset = open_dataset!(file)
    before = length(Error.unwrap!(History.list(dataset)))
    changed = Error.unwrap!(fun.(dataset))
    added = changed |> History.list() |> Error.unwrap!() |> Enum.drop(before)

    cond do
      opts[:json] -> Output.print_json(added)
      added == [] -> Output.puts("no difference")
      true -> for entry <- added, do: Output.puts("#{entry.version}: #{entry.what}")
    end

    0
  end
end

defmodule Situ.CLI.Annotate.LayerVersions do
  @moduledoc false
  # The verbs of `situ annotate` for the history of a layer of annotations.
  @behaviour Situ.CLI.Verb
  alias Situ.Annotation.{History, Layer}
  alias Situ.CLI.Annotate.Source
  alias Situ.CLI.{HistoryTable, Output, Verb}
  alias Situ.Error

  @impl true
  def verbs do
    [
      %Verb{
        words: ["annotate", "history"],
        summary: "list who changed annotations, when, and what",
        arguments: [path: path_argument()],
        options: [HistoryTable.limit_option() | Source.layer_options()],
        examples: ["situ annotate history study.json --session p01 --stream Speech.Ada"],
        run: &show_history/2
      },
      %Verb{
        words: ["annotate", "diff"],
        summary: "show the differences between two versions of annotations",
        about:
          "A version is a number from the history, a name given with `situ annotate name`, or `now`.",
        arguments: [
          path: path_argument(),
          before: HistoryTable.version_argument("the earlier version"),
          later: [kind: :text, optional: true, doc: "the later version (default: now)"]
        ],
        options: Source.layer_options(),
        examples: ["situ annotate diff study.json 12 --session p01"],
        run: &show_differences/2
      },
      %Verb{
        words: ["annotate", "name"],
        summary: "give a version of annotations a name",
        arguments: [
          path: path_argument(),
          name: [kind: :text, doc: "the name"],
          version: [kind: :text, optional: true, doc: "the version (default: now)"]
        ],
        options: Source.layer_options(),
        examples: ["situ annotate name study.json 'first pass' --session p01"],
        run: &name_version/2
      },
      %Verb{
        words: ["annotate", "restore"],
        summary:
          "restore an earlier version of annotations, as a new operation that can be undone",
        arguments: [path: path_argument(), version: HistoryTable.version_argument("the version")],
        options: Source.layer_options(),
        examples: ["situ annotate restore study.json 'first pass' --session p01"],
        run: fn args, opts ->
          change_layer(args.path, opts, &History.restore(&1, args.version))
        end
      },
      %Verb{
        words: ["annotate", "undo"],
        summary: "undo your last edit of annotations",
        arguments: [path: path_argument()],
        options: Source.layer_options(),
        run: fn args, opts -> change_layer(args.path, opts, &History.undo/1) end
      },
      %Verb{
        words: ["annotate", "redo"],
        summary: "redo the edit of annotations that you undid last",
        arguments: [path: path_argument()],
        options: Source.layer_options(),
        run: fn args, opts -> change_layer(args.path, opts, &History.redo/1) end
      }
    ]
  end

  defp path_argument, do: [kind: :recording, doc: "a store of annotations, or a dataset file"]

  defp show_history(%{path: path}, opts) do
    entries = Error.unwrap!(History.list(Source.find_layer!(path, opts)))
    HistoryTable.print_history(entries, opts)
  end

  defp show_differences(%{path: path, before: before, later: later}, opts) do
    lines = Error.unwrap!(History.diff(Source.find_layer!(path, opts), before, later || "now"))
    HistoryTable.print_differences(lines, opts)
  end

  defp name_version(%{path: path, name: name, version: version}, opts) do
    :ok =
      Error.unwrap!(History.name_version(Source.find_layer!(path, opts), name, version || "now"))

    unless opts[:json], do: Output.puts("named #{inspect(name)}")
    0
  end

  defp change_layer(path, opts, fun) do
    layer = Error.unwrap!(fun.(Source.find_layer!(path, opts)))
    count = length(Layer.annotations(layer))

    if opts[:json],
      do: Output.print_json(%{annotations: count}),
      else: Output.puts(Output.format_count(count, "annotation"))

    0
  end
end

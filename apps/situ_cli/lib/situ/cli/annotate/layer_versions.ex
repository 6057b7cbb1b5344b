defmodule Situ.CLI.Annotate.LayerVersions do
  @moduledoc false
  # The verbs of `situ annotate` for the history of a layer of annotations.
  @behaviour Situ.CLI.Verb
  alias Situ.Annotation.{History, Layer}
  alias Situ.CLI.Annotate.Source
  alias Situ.CLI.{HistoryTable, Option, Output, Verb}
  alias Situ.Dataset.{OpenSession, SessionLayers}
  alias Situ.Error

  @impl true
  def verbs do
    [
      %Verb{
        words: ["annotate", "history"],
        summary: "list who changed annotations, when, and what",
        arguments: [path: path_argument()],
        options: [HistoryTable.limit_option() | layer_options()],
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
        options: layer_options(),
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
        options: layer_options(),
        examples: ["situ annotate name study.json 'first pass' --session p01"],
        run: &name_version/2
      },
      %Verb{
        words: ["annotate", "restore"],
        summary:
          "restore an earlier version of annotations, as a new operation that can be undone",
        arguments: [path: path_argument(), version: HistoryTable.version_argument("the version")],
        options: layer_options(),
        examples: ["situ annotate restore study.json 'first pass' --session p01"],
        run: fn args, opts ->
          change_layer(args.path, opts, &History.restore(&1, args.version))
        end
      },
      %Verb{
        words: ["annotate", "undo"],
        summary: "undo your last edit of annotations",
        arguments: [path: path_argument()],
        options: layer_options(),
        run: fn args, opts -> change_layer(args.path, opts, &History.undo/1) end
      },
      %Verb{
        words: ["annotate", "redo"],
        summary: "redo the edit of annotations that you undid last",
        arguments: [path: path_argument()],
        options: layer_options(),
        run: fn args, opts -> change_layer(args.path, opts, &History.redo/1) end
      }
    ]
  end

  defp path_argument, do: [kind: :recording, doc: "a store of annotations, or a dataset file"]

  defp layer_options do
    [
      Option.new(:stream, :string, "the layer (default: the only one)", short: :s, value: "NAME"),
      Source.session_option()
    ]
  end

  defp show_history(%{path: path}, opts) do
    entries = Error.unwrap!(History.list(find_layer(path, opts)))
    HistoryTable.print_history(entries, opts)
  end

  defp show_differences(%{path: path, before: before, later: later}, opts) do
    lines = Error.unwrap!(History.diff(find_layer(path, opts), before, later || "now"))
    HistoryTable.print_differences(lines, opts)
  end

  defp name_version(%{path: path, name: name, version: version}, opts) do
    :ok = Error.unwrap!(History.name_version(find_layer(path, opts), name, version || "now"))
    unless opts[:json], do: Output.puts("named #{inspect(name)}")
    0
  end

  defp change_layer(path, opts, fun) do
    layer = Error.unwrap!(fun.(find_layer(path, opts)))
    count = length(Layer.annotations(layer))

    if opts[:json],
      do: Output.print_json(%{annotations: count}),
      else: Output.puts(Output.format_count(count, "annotation"))

    0
  end

  # Returns the store without a version, and the stream.
  defp find_layer(path, opts) do
    if Source.dataset?(path) do
      dataset = Source.open_dataset!(path)
      session = Source.choose_session!(dataset, opts[:session])
      layers = session |> OpenSession.open() |> SessionLayers.list_layers()
      names = for %{editable?: true, stream: stream} <- layers, do: stream

      {Error.unwrap!(SessionLayers.store_path(dataset, session.name)),
       choose_stream!(names, opts[:stream])}
    else
      names = path |> Source.open!(nil) |> Source.list_streams()
      {String.replace(path, ~r/\.\d{4,}\/*$/, ""), choose_stream!(names, opts[:stream])}
    end
  end

  defp choose_stream!([one], nil), do: one

  defp choose_stream!([], _stream) do
    raise Error.new(:no_layer, "the recording has no annotations that can be edited",
            fix: "create one in the studio or with `situ annotate import`"
          )
  end

  defp choose_stream!(names, nil) do
    raise Error.new(:ambiguous_stream, "there are #{length(names)} layers",
            fix: "choose one with --stream: #{Enum.join(names, ", ")}"
          )
  end

  defp choose_stream!(names, name) do
    if name in names,
      do: name,
      else:
        raise(
          Error.new(:no_layer, "layer #{inspect(name)} does not exist",
            fix: "choose from: #{Enum.join(names, ", ")}"
          )
        )
  end
end

defmodule Situ.CLI.Store.Importing do
  @moduledoc "`situ store import` and `situ store convert`: import files into stores, and convert between formats."
  @behaviour Situ.CLI.Verb
  alias Situ.Bridge.Tables
  alias Situ.CLI.{Input, Option, Output, Progress, Recording, UnfinishedOutput, Verb}
  alias Situ.CLI.Store.{Arguments, Protobuf, Saving}
  alias Situ.{Error, Store}

  @formats %{
    "arrow" => :arrow,
    "csv" => :csv,
    "json" => :json,
    "json_lines" => :json_lines,
    "message_pack" => :message_pack,
    "parquet" => :parquet,
    "protobuf" => :protobuf
  }

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "import"],
        summary: "create a store from files of other programs",
        about: """
        Recordings (MCAP, bags, video, audio, CSV ...) are imported as by `situ store copy`, several of them as by
        `concat`. Tables (Parquet, Arrow, Protobuf, and CSV, JSON and MessagePack as written by `situ store save`)
        become one stream each, named after the file. When ROS and Foxglove messages are converted to Situ's types,
        the header and the fields without a counterpart (frames, covariances ...) are kept in a second stream,
        NAME.extra, and `situ store save` restores them.
        """,
        arguments: [
          path: [
            kind: :recording,
            many: true,
            doc: "files, or patterns in quotes; - for standard input, with --format"
          ],
          out: [kind: :new, doc: "ROOT/NAME of the new store; it becomes NAME.NNNN"]
        ],
        options:
          [
            Option.new(
              :stream,
              :string,
              "the stream's name for a table, else a stream or pattern",
              short: :s,
              value: "NAME",
              many?: true
            ),
            Option.new(:format, @formats |> Map.keys() |> Enum.sort(), "the format of tables",
              short: :m
            )
          ] ++ copying() ++ Protobuf.reading(),
        examples: [
          "situ store import drive.mcap recordings/drive",
          "situ store import 'tables/*.parquet' recordings/tables",
          "situ store import levels.pb recordings/levels --type lab.Level --definition lab.proto",
          "sensor | situ store import - recordings/sensor -s Level --format json_lines"
        ],
        run: &import_files/2
      },
      %Verb{
        words: ["store", "convert"],
        summary: "convert a readable file or store to another format",
        about:
          "The extension of OUT selects the format, as with `situ store save`; without a known one OUT is a store.",
        arguments: [
          path: [kind: :recording, doc: "a store, or a file in any readable format"],
          out: [
            kind: :file,
            doc: "the file (.mcap, .bag, .parquet, .csv ...), or ROOT/NAME of a store"
          ]
        ],
        options:
          [
            Option.new(:stream, :string, "this stream, or a pattern ('Room.*'); default: all",
              short: :s,
              value: "NAME",
              many?: true
            )
          ] ++ copying() ++ Arguments.carried() ++ Protobuf.reading(),
        examples: [
          "situ store convert drive.bag drive.mcap --compression zstd",
          "situ store convert level.parquet level.csv"
        ],
        run: &convert/2
      }
    ]
  end

  defp copying do
    [
      Arguments.exclude(),
      Option.new(:from, :time, "start at this originating time"),
      Option.new(:to, :time, "end at this originating time; both ends are included"),
      Option.new(:compression, ["none", "gzip", "lz4", "zstd"], "the compression of the output"),
      Option.new(:skip_damage, :flag, "omit damaged data; without this flag it is an error"),
      Option.new(
        :times,
        ["header", "record"],
        "bags and MCAP files: take originating times from headers (default), or from the recording times"
      )
    ]
  end

  defp import_files(%{path: paths, out: out}, opts) do
    UnfinishedOutput.remove_store_at_exit(out)
    {:ok, _} = Application.ensure_all_started(:situ_bridge)
    paths = Recording.expand(paths)
    forced = opts[:format] && @formats[opts[:format]]
    formats = for path <- paths, do: {path, forced || format(path)}

    case Enum.split_with(formats, &elem(&1, 1)) do
      {tables, []} ->
        tables(tables, out, opts)

      {[], _} ->
        recordings(paths, out, opts)

      _both ->
        throw(
          {:usage, "one store cannot contain both tables and recordings: import them separately"}
        )
    end
  end

  defp format("-"), do: throw({:usage, "standard input needs a format: give --format"})
  defp format(path), do: if(File.regular?(path), do: Tables.format(path))

  defp tables(tables, out, opts) do
    given? = fn name -> opts[name] not in [nil, false, []] end

    if name = Enum.find([:from, :to, :compression, :exclude], given?),
      do:
        throw(
          {:usage, "--#{name} does not apply to tables: import the table, then copy the store"}
        )

    named =
      case {tables, opts[:stream]} do
        {_, []} -> for {path, format} <- tables, do: {Tables.name(path), path, format}
        {[{path, format}], [name]} -> [{name, path, format}]
        _ -> throw({:usage, "--stream names the stream of a single table"})
      end

    named = for {name, path, format} <- named, do: {name(name), path, table(format, opts)}

    case Progress.show("import", opts, fn _progress -> imported(named, out) end) do
      {:ok, path, counts} -> told(path, Enum.sum(Map.values(counts)), opts)
      {:error, error} -> raise error
    end
  end

  defp table(:protobuf, opts), do: {:protobuf, Protobuf.given(opts)}
  defp table(format, _opts), do: format

  defp name("-"), do: "Imported"
  defp name(name), do: name

  defp imported([{name, "-", format}], out),
    do: Input.spooled(&import_named([{name, &1, format}], out))

  defp imported(named, out), do: import_named(named, out)

  # Prints a warning about each column that the table cannot keep.
  defp import_named(named, out), do: Tables.import(named, out, notice: &Output.warn/1)

  defp recordings(paths, out, opts) do
    Recording.ready(paths)

    result =
      Progress.show("import", opts, fn progress ->
        copying = [{:empty, :refuse} | Arguments.copying(opts, progress)]

        case paths do
          [path] -> Store.copy(path, out, copying)
          several -> Store.concat(several, out, copying)
        end
      end)

    case result do
      {:ok, path} -> told(path, messages(path), opts)
      {:error, error} -> raise error
    end
  end

  defp messages(path),
    do: path |> Store.open!() |> Store.streams() |> Enum.map(& &1.count) |> Enum.sum()

  defp told(path, n, opts) do
    if opts[:json], do: Output.json(%{path: path, messages: n}), else: Output.puts(path)
    0
  end

  defp convert(%{path: path, out: out}, opts) do
    {:ok, _} = Application.ensure_all_started(:situ_bridge)

    cond do
      Saving.format(out) == nil -> import_files(%{path: [path], out: out}, opts)
      Tables.table?(path) -> through_store(path, out, opts)
      true -> Saving.save(%{path: path, file: out}, opts)
    end
  end

  # A table is not a recording, so it is first imported into a temporary store.
  defp through_store(path, out, opts) do
    Situ.Scratch.with_folder("convert", fn root ->
      format = table(Tables.format(path), opts)

      case import_named([{Tables.name(path), path, format}], Path.join(root, "t")) do
        {:ok, store, _} -> Saving.save(%{path: store, file: out}, opts)
        {:error, %Error{} = error} -> raise error
      end
    end)
  end
end

defmodule Situ.CLI.Store.Import do
  @moduledoc false
  # `situ store import` and `situ store convert`: import files into stores, and convert between
  # formats.
  @behaviour Situ.CLI.Verb
  alias Situ.Bridge.TableImport
  alias Situ.CLI.{Input, Option, Output, Progress, Recording, UnfinishedOutput, Verb}
  alias Situ.CLI.Store.{Arguments, Protobuf, Export}
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

  @extensions %{
    arrow: ".arrow",
    csv: ".csv",
    json: ".json",
    json_lines: ".jsonl",
    message_pack: ".msgpack",
    parquet: ".parquet",
    protobuf: ".pb"
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
          ] ++ copy_option_specs() ++ Protobuf.read_options(),
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
          ] ++
            copy_option_specs() ++
            [Arguments.nested_option()] ++ Arguments.mcap_options() ++ Protobuf.read_options(),
        examples: [
          "situ store convert drive.bag drive.mcap --compression zstd",
          "situ store convert level.parquet level.csv"
        ],
        run: &convert_file/2
      }
    ]
  end

  defp copy_option_specs do
    [
      Arguments.exclude_option(),
      Option.new(:from, :time, "start at this originating time"),
      Option.new(:to, :time, "end at this originating time; both ends are included"),
      Option.new(
        :compression,
        ["none", "gzip", "lz4", "zstd", "snappy"],
        "the compression of the output"
      ),
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

    case Recording.expand_patterns(paths) do
      ["-"] -> import_input(out, opts)
      paths -> import_paths(paths, out, opts)
    end
  end

  # The name of the file becomes the name of the stream.
  defp import_input(out, opts) do
    format = opts[:format] || throw({:usage, "standard input needs a format: give --format"})
    name = "Imported" <> @extensions[@formats[format]]
    Input.with_spooled_file(name, &import_paths([&1], out, opts))
  end

  defp import_paths(paths, out, opts) do
    formats = for path <- paths, do: {path, table_format(path, @formats[opts[:format]])}

    case Enum.split_with(formats, &elem(&1, 1)) do
      {tables, []} ->
        import_tables(tables, out, opts)

      {[], _} ->
        import_recordings(paths, out, opts)

      _both ->
        throw(
          {:usage, "one store cannot contain both tables and recordings: import them separately"}
        )
    end
  end

  defp table_format("-", _format),
    do: throw({:usage, "standard input cannot be imported together with files"})

  defp table_format(path, nil), do: if(File.regular?(path), do: TableImport.detect_format(path))

  # A CSV file is a table only if it has the heading of Situ's own files.
  defp table_format(path, :csv) do
    if String.downcase(Path.extname(path)) in [".csv", ".tsv"],
      do: TableImport.detect_format(path),
      else: :csv
  end

  defp table_format(_path, format), do: format

  defp import_tables(tables, out, opts) do
    given? = fn name -> opts[name] not in [nil, false, []] end

    if name = Enum.find([:from, :to, :compression, :exclude], given?),
      do:
        throw(
          {:usage, "--#{name} does not apply to tables: import the table, then copy the store"}
        )

    named =
      case {tables, opts[:stream]} do
        {_, []} -> for {path, format} <- tables, do: {TableImport.stream_name(path), path, format}
        {[{path, format}], [name]} -> [{name, path, format}]
        _ -> throw({:usage, "--stream names the stream of a single table"})
      end

    named = for {name, path, format} <- named, do: {name, path, with_table_options(format, opts)}

    case Progress.with_progress("import", opts, fn _progress -> import_named(named, out) end) do
      {:ok, path, counts} -> report_import(path, Enum.sum(Map.values(counts)), opts)
      {:error, error} -> raise error
    end
  end

  defp with_table_options(:protobuf, opts), do: {:protobuf, Protobuf.parse_options(opts)}
  defp with_table_options(format, _opts), do: format

  # Prints a warning about each column that the table cannot keep.
  defp import_named(named, out), do: TableImport.import(named, out, notice: &Output.warn/1)

  defp import_recordings(paths, out, opts) do
    Recording.load_formats(paths)

    result =
      Progress.with_progress("import", opts, fn progress ->
        copying = [{:empty, :refuse} | Arguments.copy_options(opts, progress)]

        case paths do
          [path] -> Store.copy(path, out, copying)
          several -> Store.concat(several, out, copying)
        end
      end)

    case result do
      {:ok, path} -> report_import(path, count_messages(path), opts)
      {:error, error} -> raise error
    end
  end

  defp count_messages(path),
    do: path |> Store.open!() |> Store.streams() |> Enum.map(& &1.count) |> Enum.sum()

  defp report_import(path, n, opts) do
    if opts[:json], do: Output.print_json(%{path: path, messages: n}), else: Output.puts(path)
    0
  end

  defp convert_file(%{path: path, out: out}, opts) do
    {:ok, _} = Application.ensure_all_started(:situ_bridge)

    cond do
      Export.format_from_extension(out) == nil -> import_files(%{path: [path], out: out}, opts)
      TableImport.table?(path) -> convert_via_store(path, out, opts)
      true -> Export.save_file(%{path: path, file: out}, opts)
    end
  end

  # A table is not a recording, so it is first imported into a temporary store.
  defp convert_via_store(path, out, opts) do
    Situ.TempFolder.with_folder("convert", fn root ->
      format = with_table_options(TableImport.detect_format(path), opts)

      case import_named([{TableImport.stream_name(path), path, format}], Path.join(root, "t")) do
        {:ok, store, _} -> Export.save_file(%{path: store, file: out}, opts)
        {:error, %Error{} = error} -> raise error
      end
    end)
  end
end

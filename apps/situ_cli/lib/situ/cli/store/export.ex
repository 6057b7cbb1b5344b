defmodule Situ.CLI.Store.Export do
  @moduledoc false
  # `situ store save`: writes messages to files that other programs can read.
  @behaviour Situ.CLI.Verb
  alias Situ.Bridge.{Arrow, Mcap, Parquet, RawMessages, Ros}
  alias Situ.CLI.{FileKinds, Option, Output, Progress, Recording, UnfinishedOutput, Verb}
  alias Situ.CLI.Store.{Arguments, OutputFile, PanelFiles, Protobuf, Records}
  alias Situ.{Error, Store}

  # Files of these formats contain complete recordings.
  @recordings %{mcap: Mcap, bag: Ros.Bag, db3: Ros.Db3}
  @tables %{parquet: Parquet, arrow: Arrow}

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "save"],
        aliases: ["export"],
        summary:
          "export messages to a file: CSV, JSON, MessagePack, Parquet, Arrow, Protobuf, MCAP, bags, MP4, HTML",
        about: """
        MCAP files and bags contain all or the selected streams. Other files contain one stream; with --on, a table
        contains several streams, joined on time. CSV, JSON and MessagePack have the layouts of Situ.Bridge.Format,
        which \\psi reads and writes as well. Images that are stored as video become a video file (.mp4, .mov, .mkv,
        .webm) without being encoded again; it begins with a key frame. With --over or --sound, the images of one stream
        are encoded as MP4 with other streams drawn over them. An HTML page shows the streams as the studio does, with
        zoom and cursor, and opens without a server. Plain numbers are written to CSV, Parquet and
        Arrow at a million per second or more.
        """,
        arguments: [
          path: [
            kind: :recording,
            doc:
              "a store's folder, ROOT/NAME for its newest version NAME.NNNN, or an external file"
          ],
          file: [
            kind: :file,
            doc:
              "the file to write (.csv, .json, .parquet, .mcap, .bag, .db3, .mp4 ...; `situ formats` lists all); - " <>
                "for standard output"
          ]
        ],
        options:
          Arguments.stream_options("this stream, or a pattern ('Room.*'); default: all") ++
            [
              Option.new(
                :format,
                FileKinds.export_words(),
                "the format, regardless of the file's extension",
                short: :m
              ),
              Option.new(:from, :time, "start at this originating time"),
              Option.new(:to, :time, "end at this originating time"),
              Arguments.nested_option(),
              Option.new(
                :compression,
                ["none", "gzip", "lz4", "zstd", "snappy"],
                "for Parquet (zstd, snappy, gzip, none), MCAP (none, lz4, zstd) and bags (none, lz4)"
              ),
              Option.new(
                :on,
                :string,
                "Parquet, Arrow: all streams in one table, with a row for each message of this stream",
                value: "STREAM"
              ),
              Option.new(
                :latest,
                :flag,
                "with --on: take other streams' latest values, not the nearest"
              ),
              Option.new(
                :within,
                :span,
                "with --on: leave cells empty if no value is this close"
              ),
              Option.new(
                :skip_damage,
                :flag,
                "omit damaged data; without this flag it is an error"
              )
            ] ++ PanelFiles.options() ++ Arguments.mcap_options() ++ Protobuf.file_options(),
        examples: [
          "situ store save recordings/lobby levels.csv -s Lobby.Level",
          "situ store save recordings/lobby - -s Lobby.Level --format json_lines | jq .message",
          "situ store save recordings/drive drive.parquet --on Speed -s Pose --within 50ms",
          "situ store save recordings/lobby camera.mp4 -s Camera",
          "situ store save recordings/lobby lobby.html --from 2026-01-31T12:00:00Z --to 2026-01-31T12:01:00Z",
          "situ store save recordings/lobby lobby.mcap -x 'Lobby.Video*'"
        ],
        run: &save_file/2
      }
    ]
  end

  @doc "Returns the format of a file by its extension, or `nil`."
  @spec format_from_extension(Path.t()) :: atom()
  def format_from_extension(file) do
    extension = file |> Path.extname() |> String.downcase()
    Enum.find_value(FileKinds.list_exports(), &(extension in &1.export && &1.name))
  end

  @doc "Writes the file; takes the arguments and options of the verb."
  @spec save_file(map(), keyword()) :: 0
  def save_file(%{path: path, file: file}, opts) do
    format = FileKinds.find_export(opts[:format]) || format_from_extension(file)

    unless format,
      do:
        throw(
          {:usage, "unknown format: give --format, or a file that ends in #{known_extensions()}"}
        )

    _ = nested_option(format, opts)
    {:ok, _} = Application.ensure_all_started(:situ_bridge)
    {:ok, _} = Application.ensure_all_started(:situ_media)
    store = Recording.open!(path)
    infos = Arguments.select_streams!(store, opts)
    if file != "-", do: UnfinishedOutput.remove_file_at_exit(file)

    saved =
      Progress.with_progress("save", opts, fn progress ->
        write_format(format, store, infos, file, opts, progress)
      end)

    if opts[:json] && file != "-",
      do: Output.print_json(Map.merge(%{file: file, format: format}, saved))

    0
  end

  # Messages of MCAP files and bags are copied as they are where the new format allows it.
  defp write_format(format, store, infos, file, opts, progress)
       when is_map_key(@recordings, format) do
    reject_join!(opts)
    refuse_stdout!(file, format)

    if RawMessages.copyable?(store, format, Enum.map(infos, & &1.name)),
      do: copy_raw(format, store, infos, file, opts, progress),
      else: encode_recording(format, store, infos, file, opts, progress)
  end

  defp write_format(format, store, infos, file, opts, progress)
       when is_map_key(@tables, format) do
    [] = carried_options(format, opts)
    refuse_stdout!(file, format)

    join =
      "; or join several into one table, with a row for each message of one of them: " <>
        "`situ store save #{store.path} #{file} --on STREAM`"

    info =
      if opts[:on], do: fetch_stream!(store, opts[:on]), else: single_stream!(store, infos, join)

    written =
      [progress: &progress.(&1, info.count)] ++
        compression_option(format, opts[:compression]) ++ nested_option(format, opts)

    write_table(
      opts[:on],
      @tables[format],
      {store, info, infos},
      file,
      opts,
      read_options(opts) ++ written
    )
  end

  defp write_format(:protobuf, store, infos, file, opts, progress) do
    reject_join!(opts)
    [] = carried_options(:protobuf, opts) ++ compression_option(:protobuf, opts[:compression])
    refuse_stdout!(file, :protobuf)

    Protobuf.save_stream(
      store,
      single_stream!(store, infos),
      file,
      opts,
      {read_options(opts), progress}
    )
  end

  defp write_format(:html, store, infos, file, opts, progress),
    do: PanelFiles.save_page(store, infos, file, opts, progress)

  defp write_format(:video, store, infos, file, opts, progress) do
    reject_join!(opts)
    [] = carried_options(:video, opts) ++ compression_option(:video, opts[:compression])
    refuse_stdout!(file, :video)
    PanelFiles.save_video(store, single_stream!(store, infos), file, opts, progress)
  end

  defp write_format(format, store, infos, file, opts, progress) do
    reject_join!(opts)
    [] = carried_options(format, opts)
    unless compression_option(format, opts[:compression]) == [], do: reject_compression(format)
    info = single_stream!(store, infos)
    parts = Store.columns(store, info, read_options(opts))
    count = Records.save_parts(format, parts, file, &progress.(&1, info.count))
    %{messages: count, stream: info.name}
  end

  defp copy_raw(format, store, infos, file, opts, progress) do
    all? = length(infos) == length(Store.streams(store))
    names = unless all?, do: Enum.map(infos, & &1.name)
    total = infos |> Enum.map(& &1.count) |> Enum.sum()
    copying = [streams: names, progress: &progress.(&1, total)] ++ Keyword.take(opts, [:order])
    {format, file} |> write_raw([store], copying, opts) |> Map.put(:streams, length(infos))
  end

  @doc "Merges several MCAP files or bags into a new one; returns the exit status."
  @spec merge_files([Path.t()], Path.t(), keyword()) :: 0
  def merge_files(paths, file, opts) do
    format = format_from_extension(file)
    stores = Enum.map(paths, &Recording.open!/1)

    for store <- stores, not RawMessages.copyable?(store, format) do
      raise Error.new(:not_raw, "#{store.path} cannot be merged into #{Path.basename(file)}",
              why: "files are merged without encoding messages again, which its messages need",
              fix: "create a store, then run `situ store convert STORE #{file}`"
            )
    end

    UnfinishedOutput.remove_file_at_exit(file)
    total = for store <- stores, info <- Store.streams(store), do: info.count

    merged =
      Progress.with_progress("write", opts, fn progress ->
        copying = [streams: choose_names(stores, opts), progress: &progress.(&1, Enum.sum(total))]
        write_raw({format, file}, stores, copying, opts)
      end)

    if opts[:json], do: Output.print_json(Map.put(merged, :file, file)), else: Output.puts(file)
    0
  end

  # A stream that only some of the files have is copied from these.
  defp choose_names(stores, opts) do
    if (opts[:stream] || []) != [] or (opts[:exclude] || []) != [] do
      infos = Enum.flat_map(stores, &Store.streams/1)
      for name <- infos |> Enum.map(& &1.name) |> Enum.uniq(), chosen?(name, opts), do: name
    end
  end

  defp chosen?(name, opts) do
    matches? = fn patterns -> Enum.any?(patterns, &Arguments.name_matches?(name, &1)) end
    chosen = opts[:stream] || []
    (chosen == [] or matches?.(chosen)) and not matches?.(opts[:exclude] || [])
  end

  defp write_raw({format, file}, stores, copying, opts) do
    written =
      [format: format, name: Path.basename(file)] ++
        compression_option(format, opts[:compression]) ++ carried_options(format, opts)

    copying = copying ++ read_options(opts) ++ written
    copied = OutputFile.write_then_rename!(file, &RawMessages.copy(stores, &1, copying))
    if format == :db3, do: Error.unwrap!(Ros.Db3.write_beside(file))
    for sentence <- copied.left_out, do: Output.warn("Omitted: " <> sentence)
    copied
  end

  defp encode_recording(format, store, infos, file, opts, progress) do
    total = infos |> Enum.map(& &1.count) |> Enum.sum()
    names = Enum.map(infos, & &1.name)
    written = [progress: &progress.(&1, total)] ++ compression_option(format, opts[:compression])
    named = if format == :db3, do: [name: Path.basename(file)], else: []

    exporting =
      [streams: names] ++
        named ++ read_options(opts) ++ written ++ carried_options(format, opts)

    count = OutputFile.write_then_rename!(file, &@recordings[format].export(store, &1, exporting))
    if format == :db3, do: Error.unwrap!(Ros.Db3.write_beside(file))
    %{messages: count, streams: length(names)}
  end

  defp write_table(nil, module, {store, info, _chosen}, file, _opts, written),
    do: %{
      messages: Error.unwrap!(module.write(store, info.name, file, written)),
      stream: info.name
    }

  defp write_table(on, module, {store, _info, infos}, file, opts, written) do
    # If no streams are selected, the table contains every stream that fits into a table.
    all? = (opts[:stream] || []) == [] and (opts[:exclude] || []) == []
    joining = [on: on, streams: unless(all?, do: Enum.map(infos, & &1.name))]
    joining = [take: if(opts[:latest], do: :latest, else: :nearest)] ++ joining
    joining = Keyword.take(opts, [:within]) ++ joining
    %{messages: Error.unwrap!(module.join(store, file, joining ++ written)), stream: on}
  end

  defp nested_option(format, opts) do
    cond do
      opts[:nested] != true -> []
      format == :parquet and opts[:on] == nil -> [nested: true]
      true -> throw({:usage, "--nested is for one stream as Parquet"})
    end
  end

  defp fetch_stream!(store, name), do: Error.unwrap!(Store.stream_info(store, name))

  defp reject_join!(opts) do
    if opts[:on], do: throw({:usage, "--on needs a table: Parquet or Arrow"})
  end

  defp carried_options(:mcap, opts),
    do: [attachments: opts[:attach] || [], metadata: metadata_records(opts)]

  defp carried_options(format, opts) do
    if (opts[:attach] || []) != [] or (opts[:metadata] || []) != [],
      do:
        throw({:usage, "#{format} files cannot contain attachments or metadata; MCAP files can"})

    []
  end

  defp metadata_records(opts), do: Arguments.parse_records!(opts[:metadata] || [])

  defp known_extensions,
    do: FileKinds.list_exports() |> Enum.flat_map(& &1.export) |> Enum.sort() |> Enum.join(", ")

  defp read_options(opts),
    do: [skip_damage: opts[:skip_damage] == true] ++ Keyword.take(opts, [:from, :to])

  @packed %{parquet: ~w(none snappy gzip zstd), mcap: ~w(none lz4 zstd), bag: ~w(none lz4)}

  defp compression_option(_format, nil), do: []

  defp compression_option(format, word) do
    if word in Map.get(@packed, format, []),
      do: [compression: String.to_existing_atom(word)],
      else: reject_compression(format)
  end

  defp reject_compression(format) do
    known = Map.get(@packed, format, [])

    fix = if known == [], do: "compress the file with gzip", else: "use #{Enum.join(known, ", ")}"

    throw({:usage, "#{format} does not support this --compression; #{fix}"})
  end

  # These formats have an index at the end, and the file is renamed when it is complete.
  defp refuse_stdout!("-", format),
    do:
      throw(
        {:usage,
         "#{format} cannot be written to standard output: such a file is complete only at its end"}
      )

  defp refuse_stdout!(_file, _format), do: :ok

  defp single_stream!(store, infos, alternative \\ "")
  defp single_stream!(_store, [one], _alternative), do: one

  defp single_stream!(store, several, alternative) do
    names = several |> Enum.take(8) |> Enum.map_join(", ", & &1.name)

    raise Error.new(:ambiguous_stream, "#{store.path} has #{length(several)} streams",
            fix: "choose one with --stream: #{names}#{alternative}"
          )
  end
end

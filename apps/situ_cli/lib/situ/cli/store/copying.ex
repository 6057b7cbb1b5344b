defmodule Situ.CLI.Store.Copying do
  @moduledoc false
  # The verbs of `situ store` that create new recordings from others: copy, crop, concat, split,
  # remove, edit.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, Progress, Recording, UnfinishedOutput, Verb}
  alias Situ.CLI.Store.{Arguments, Export}
  alias Situ.{Error, Store}

  @recording [
    kind: :recording,
    doc:
      "a store's folder, ROOT/NAME for all segments or the newest version NAME.NNNN, or an external file"
  ]
  @new [kind: :new, doc: "ROOT/NAME of the new store; it becomes NAME.NNNN"]
  @about """
  The original is never changed. The new store gets its name only when it is complete and on disk; if the command is
  stopped (Ctrl-C), it leaves nothing.
  """

  @new_file [kind: :new, doc: "ROOT/NAME of the new store, or a file (.mcap, .bag, .csv ...)"]
  @mcap "An MCAP file copied to another keeps every byte of its messages, their times, schemas and attachments."

  @kept """
  An MCAP file or a bag stays one: OUT gets its extension unless it has one. `situ store import` makes a store of it.
  """

  @impl true
  def verbs do
    copy_verbs() ++
      [
        %Verb{
          words: ["store", "crop"],
          summary: "create a store with an interval of a recording",
          about: @about <> @kept,
          arguments: [path: @recording, out: @new_file],
          options:
            [
              Option.new(:start, :span, "start this long after the recording's first message"),
              Option.new(:length, :span, "the length of the interval")
            ] ++ interval_options() ++ Arguments.stream_options() ++ storage_options(),
          examples: ["situ store crop recordings/lobby lunch --start 30m --length 10m"],
          run: &crop_recording/2
        },
        %Verb{
          words: ["store", "concat"],
          aliases: ["merge"],
          summary:
            "concatenate several recordings into one store; streams of the same name are joined",
          about:
            @about <>
              "MCAP files and bags are merged into a file (.mcap, .bag, .db3) without a change of their messages, " <>
              "in order of time.",
          arguments: [path: Keyword.put(@recording, :many, true), out: @new_file],
          options: Arguments.stream_options() ++ interval_options() ++ storage_options(),
          examples: [
            "situ store concat monday tuesday week",
            "situ store concat monday.mcap tuesday.bag week.mcap -s '/imu'"
          ],
          run: fn %{path: paths, out: out}, opts ->
            paths = Recording.expand_patterns(paths)

            if Export.format_from_extension(out),
              do: merge_files(paths, out, opts),
              else:
                write_store(paths, out, opts, &Store.concat(paths, out, copy_options(opts, &1)))
          end
        },
        %Verb{
          words: ["store", "split"],
          summary: "cut a recording into stores of equal length, OUT-001, OUT-002 ...",
          about: @about <> @kept,
          arguments: [path: @recording, out: @new],
          options:
            [Option.new(:every, :span, "the length of each store")] ++
              Arguments.stream_options() ++ storage_options(),
          examples: ["situ store split recordings/day hours --every 1h"],
          run: &split_recording/2
        },
        %Verb{
          words: ["store", "remove"],
          aliases: ["remove-stream", "removestream"],
          summary: "create the next version of a store, without some of its streams",
          about: "The previous version is kept; `situ store delete` deletes it.",
          arguments: [
            path: @recording,
            stream: [kind: :text, many: true, doc: "names or patterns of streams"]
          ],
          options: storage_options(),
          examples: ["situ store remove recordings/lobby 'Lobby.Debug.*'"],
          run: &remove_streams/2
        },
        %Verb{
          words: ["store", "edit"],
          summary: "create a store with individual messages changed or deleted",
          about: @about,
          arguments: [path: @recording, out: @new],
          options: [
            Option.new(:set, :string, "add or replace the message at this time",
              value: "STREAM@TIME=JSON",
              many?: true
            ),
            Option.new(:delete, :string, "delete the message at this time",
              value: "STREAM@TIME",
              many?: true
            ),
            skip_damage()
          ],
          examples: [
            "situ store edit recordings/lobby corrected --set 'Words@2026-01-31T12:00:00Z=\"five\"'"
          ],
          run: &edit_messages/2
        }
      ]
  end

  defp copy_verbs do
    [
      copy_verb("copy", "create a store or file with all or some streams of a recording", [
        "situ store copy talk1.mp4 recordings/talk",
        "situ store copy recordings/lobby small --exclude 'Lobby.Video*' --compression zstd",
        "situ store copy drive.mcap imu.mcap -s '/imu/*'"
      ]),
      copy_verb("compress", "copy with compression (zstd unless --compression is given)", [
        "situ store compress drive.mcap small.mcap"
      ]),
      copy_verb("decompress", "copy without compression", [
        "situ store decompress small.mcap drive.mcap"
      ]),
      copy_verb("sort", "copy, and sort the messages of an MCAP file by log time", [
        "situ store sort drive.mcap sorted.mcap"
      ])
    ]
  end

  defp copy_verb(word, summary, examples) do
    %Verb{
      words: ["store", word],
      aliases: if(word == "copy", do: ["filter"], else: []),
      summary: summary,
      about: @about <> @mcap,
      arguments: [path: @recording, out: @new_file],
      options: Arguments.stream_options() ++ interval_options() ++ storage_options(),
      examples: examples,
      run: fn arguments, opts ->
        copy_recording(word, arguments, put_defaults(word, opts))
      end
    }
  end

  defp put_defaults("compress", opts), do: Keyword.put_new(opts, :compression, "zstd")
  defp put_defaults("decompress", opts), do: Keyword.put_new(opts, :compression, "none")
  defp put_defaults("sort", opts), do: Keyword.put(opts, :order, :time)
  defp put_defaults("copy", opts), do: opts

  # The file's extension selects the format, as with `situ store save`.
  defp copy_recording(word, %{path: path, out: out}, opts) when word != "copy",
    do: copy_recording("copy", %{path: path, out: keep_extension(path, out)}, opts)

  defp copy_recording("copy", %{path: path, out: out}, opts) do
    if Export.format_from_extension(out),
      do: Export.save_file(%{path: path, file: out}, opts),
      else: write_store([path], out, opts, &Store.copy(path, out, copy_options(opts, &1)))
  end

  # Prints the name if it is not the given one.
  defp save_kept(path, out, kept, opts) do
    0 = Export.save_file(%{path: path, file: kept}, opts)
    if kept != out and opts[:json] != true, do: Output.puts(kept)
    0
  end

  # Cutting does not change the kind of a file.
  defp keep_extension(path, out) do
    extension = Path.extname(path)

    if File.regular?(path) and Export.format_from_extension(path) in [:mcap, :bag, :db3] and
         Export.format_from_extension(out) == nil,
       do: out <> extension,
       else: out
  end

  defp merge_files(paths, out, opts) do
    Recording.load_formats(paths)
    Export.merge_files(paths, out, opts)
  end

  # Some verbs can only create stores.
  defp check_store!(verb, out) do
    if Export.format_from_extension(out) do
      raise Error.new(
              :not_a_store,
              "`situ store #{verb}` creates a store, not #{Path.basename(out)}",
              fix:
                "create a store, then run `situ store convert STORE #{out}`; copy, filter, compress, sort and crop " <>
                  "can create files as well"
            )
    end
  end

  defp interval_options do
    [
      Option.new(:from, :time, "start at this originating time"),
      Option.new(:to, :time, "end at this originating time; both ends are included")
    ]
  end

  defp storage_options do
    [
      Option.new(:compression, ["none", "lz4", "zstd"], "for the new store (default: unchanged)"),
      skip_damage()
    ]
  end

  defp skip_damage,
    do: Option.new(:skip_damage, :flag, "omit damaged data; without this flag it is an error")

  defp copy_options(opts, progress),
    do: [{:empty, :refuse} | Arguments.copy_options(opts, progress)]

  defp crop_recording(%{path: path, out: out}, opts) do
    if Keyword.take(opts, [:from, :to, :start, :length]) == [],
      do: throw({:usage, "no interval given: give --start and --length, or --from and --to"})

    kept = keep_extension(path, out)

    if Export.format_from_extension(kept),
      do: save_kept(path, out, kept, Arguments.parse_interval!(path, opts)),
      else: write_store([path], out, opts, &Store.crop(path, out, copy_options(opts, &1)))
  end

  defp write_store(paths, out, opts, make) do
    Recording.load_formats(paths)
    UnfinishedOutput.remove_store_at_exit(out)
    path = Progress.with_progress("write", opts, fn progress -> unwrap!(make.(progress)) end)
    if opts[:json], do: Output.print_json(%{path: path}), else: Output.puts(path)
    0
  end

  defp split_recording(%{path: path, out: out}, opts) do
    every = opts[:every] || throw({:usage, "no length given: give --every SPAN"})
    check_store!("split", out)
    if every <= 0, do: throw({:usage, "--every must be greater than 0"})
    store = Recording.open!(path)

    paths =
      case Store.interval(store) do
        nil -> []
        {first, last} -> make_parts(path, out, {first, last, every}, opts)
      end

    if opts[:json], do: Output.print_json(%{paths: paths}), else: Enum.each(paths, &Output.puts/1)
    0
  end

  defp make_parts(path, out, {first, last, every}, opts) do
    for {from, n} <- Enum.with_index(first..last//every, 1),
        name = "#{out}-#{n |> Integer.to_string() |> String.pad_leading(3, "0")}",
        made =
          make_part(path, keep_extension(path, name), {from, min(from + every - 1, last)}, opts),
        do: made
  end

  # No store is created for an interval without messages.
  defp make_part(path, name, {from, to}, opts) do
    if Export.format_from_extension(name),
      do: save_part(path, name, [from: from, to: to] ++ opts),
      else: copy_part(path, name, {from, to}, opts)
  end

  defp save_part(path, name, opts) do
    store = Recording.open!(path)

    if Enum.any?(Store.streams(store), &messages_between?(store, &1, opts[:from], opts[:to])) do
      0 = Export.save_file(%{path: path, file: name}, Keyword.delete(opts, :json))
      name
    end
  end

  defp messages_between?(store, info, from, to),
    do: store |> Store.messages(info, from: from, to: to, envelopes: true) |> Enum.any?()

  defp copy_part(path, name, {from, to}, opts) do
    UnfinishedOutput.remove_store_at_exit(name)

    Progress.with_progress(Path.basename(name), opts, fn progress ->
      case Store.copy(path, name, [from: from, to: to] ++ copy_options(opts, progress)) do
        {:error, %Error{code: :empty_interval}} -> nil
        result -> unwrap!(result)
      end
    end)
  end

  defp remove_streams(%{path: path, stream: unwanted}, opts) do
    store = Recording.open!(path)
    check_one_store!(store, unwanted)
    name = Store.info(store).name
    out = Path.join(Path.dirname(store.path), name)
    streams = Arguments.copy_options([exclude: unwanted], fn _, _ -> :ok end)[:streams]
    infos = Enum.filter(Store.streams(store), streams)

    if length(infos) == length(Store.streams(store)) do
      raise Error.new(
              :no_stream,
              "no stream of #{store.path} matches #{Enum.join(unwanted, ", ")}",
              fix: "run `situ store info` to list its streams"
            )
    end

    write_store([path], out, opts, fn progress ->
      Store.copy(store.path, out, [streams: streams] ++ copy_options(opts, progress))
    end)
  end

  # The recorder would continue its segments after the new version.
  defp check_one_store!(store, unwanted) do
    if Store.segments(store) != [] do
      raise Error.new(
              :segmented,
              "#{store.path} is a recording in segments, which has no further versions",
              why: "the new version would hide its segments",
              fix:
                "create another recording: `situ store copy '#{store.path}' NEW --exclude '#{hd(unwanted)}'`"
            )
    end
  end

  defp edit_messages(%{path: path, out: out}, opts) do
    check_store!("edit", out)

    case Arguments.parse_edits!(Recording.open!(path), opts) do
      none when none == %{} ->
        throw({:usage, "no changes given: give --set or --delete"})

      edits ->
        write_store(
          [path],
          out,
          opts,
          &Store.edit(path, out, edits, Arguments.damage_options(opts) ++ [progress: &1])
        )
    end
  end

  defp unwrap!({:ok, value}), do: value
  defp unwrap!({:error, error}), do: raise(error)
end

defmodule Situ.CLI.Store.Maintenance do
  @moduledoc false
  # The verbs of `situ store` that change a store in place: verify, repair, compact, delete,
  # rename, move.
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, Progress, Recording, UnfinishedOutput, Verb}
  alias Situ.CLI.Store.{Arguments, Repair}
  alias Situ.Dataset.Relocation
  alias Situ.Store

  @store [
    kind: :recording,
    doc: "a store's folder, or ROOT/NAME for all segments or the newest version NAME.NNNN"
  ]

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "verify"],
        aliases: ["doctor"],
        summary: "check all checksums; status 1 if anything is damaged",
        arguments: [path: Keyword.put(@store, :many, true)],
        examples: ["situ store verify 'recordings/*'"],
        run: fn %{path: paths}, opts ->
          Repair.verify_paths(Recording.expand_patterns(paths), opts)
        end
      },
      %Verb{
        words: ["store", "repair"],
        aliases: ["recover", "reindex"],
        summary: "repair a store that is damaged or was not closed; intact data is kept",
        about: """
        A store is repaired in place. An MCAP file is not changed: all readable messages, before and after the damage,
        are copied byte for byte into OUT, which gets an index.
        """,
        arguments: [
          path: @store,
          out: [kind: :file, optional: true, doc: "the new file (only for an MCAP file)"]
        ],
        options: [Option.new(:dry_run, :flag, "only print the planned repairs")],
        examples: [
          "situ store repair recordings/lobby.0007",
          "situ store repair broken.mcap repaired.mcap"
        ],
        run: fn %{path: path} = arguments, opts ->
          Repair.repair_path(path, arguments[:out], opts)
        end
      },
      %Verb{
        words: ["store", "compact"],
        summary: "rewrite a store in place, with full chunks instead of many small commits",
        about: """
        The recording becomes smaller and faster to read; its messages do not change. It keeps its name at all times,
        so nothing is lost if the program is killed. The disk needs space for a second copy. A store that is being
        written is rejected.
        """,
        arguments: [path: Keyword.put(@store, :many, true)],
        options: [
          Option.new(
            :compression,
            ["none", "lz4", "zstd"],
            "for all streams (default: unchanged)"
          ),
          Option.new(
            :skip_damage,
            :flag,
            "omit damaged data; without this flag it is an error"
          )
        ],
        examples: ["situ store compact recordings/lobby.0000"],
        run: fn %{path: paths}, opts -> compact_stores(Recording.expand_patterns(paths), opts) end
      },
      %Verb{
        words: ["store", "delete"],
        summary: "delete a store (asks first)",
        arguments: [path: @store],
        options: [Option.new(:yes, :flag, "do not ask", short: :y)],
        run: &delete_store/2
      },
      %Verb{
        words: ["store", "rename"],
        summary: "rename a store",
        arguments: [path: @store, name: [kind: :text, doc: "the new name"]],
        examples: ["situ store rename recordings/lobby.0000 entrance"],
        run: &rename_store/2
      },
      %Verb{
        words: ["store", "move"],
        summary: "move a store to another folder, with its segments, annotations and bookmarks",
        about: """
        The folder may be on another disk. Everything keeps its name. Datasets in the old and the new folder, in the
        folders that contain them, and in the working directory then name the new path, as does each --dataset. If the
        command is killed, the same command completes it; until then, the recording cannot be opened.
        """,
        arguments: [
          path: @store,
          folder: [kind: :file, doc: "the new folder; it is created if necessary"]
        ],
        options: [
          Option.new(:dataset, :path, "a dataset file elsewhere that names the recording",
            many?: true,
            value: "FILE"
          )
        ],
        examples: [
          "situ store move recordings/lobby /archive/2026",
          "situ store move recordings/lobby.0000 /archive --dataset ~/study.json"
        ],
        run: &move_store/2
      }
    ]
  end

  defp compact_stores(paths, opts) do
    done =
      for path <- paths do
        store = Recording.open!(path)
        folder = store.path
        UnfinishedOutput.remove_store_at_exit(folder)
        before = Recording.disk_size(store)
        copying = Arguments.copy_options(opts, fn _, _ -> :ok end)

        Progress.with_progress("compact", opts, fn progress ->
          unwrap!(
            Store.compact(folder, [progress: progress] ++ Keyword.delete(copying, :progress))
          )
        end)

        %{path: folder, before: before, size: Recording.disk_size(Recording.open!(folder))}
      end

    if opts[:json], do: Output.print_json(done), else: Enum.each(done, &print_compacted/1)
    0
  end

  defp print_compacted(%{path: path, before: before, size: size}),
    do:
      Output.puts(
        "#{path}: #{Output.format_bytes(before)} before, #{Output.format_bytes(size)} now"
      )

  defp rename_store(%{path: path, name: name}, opts) do
    path = unwrap!(Store.rename(path, name))
    if opts[:json], do: Output.print_json(%{path: path}), else: Output.puts(path)
    0
  end

  defp move_store(%{path: path, folder: folder}, opts) do
    command = self()
    own = Enum.map(opts[:dataset] || [], &Path.expand/1)
    files = own ++ (Relocation.list_dataset_files(nearby_folders(path, folder)) -- own)
    finish = &relocate_datasets(files, own, &1, command)

    moved =
      Progress.with_progress("copy", opts, fn progress ->
        unwrap!(Store.move(path, folder, progress: progress, finish: finish))
      end)

    changed = receive do: ({:relocated, changed} -> changed)

    if opts[:json] do
      Output.print_json(%{path: moved, datasets: changed})
    else
      Output.puts(moved)

      for change <- changed,
          do: Output.puts("#{change.dataset}: #{change.session}, #{change.partition}")
    end

    0
  end

  defp nearby_folders(path, folder) do
    roots = [path |> Path.expand() |> Path.dirname(), Path.expand(folder)]
    roots ++ Enum.map(roots, &Path.dirname/1) ++ [File.cwd!()]
  end

  # A dataset that the user has named must be changed. A file that was only found may be unreadable.
  defp relocate_datasets(files, own, pairs, command) do
    files
    |> Enum.reduce_while({:ok, []}, fn file, {:ok, changed} ->
      case Relocation.relocate_file(file, pairs) do
        {:ok, moved} ->
          found =
            for {session, name} <- moved, do: %{dataset: file, session: session, partition: name}

          {:cont, {:ok, changed ++ found}}

        {:error, error} ->
          skip_dataset(error, file, changed, file in own)
      end
    end)
    |> case do
      {:ok, changed} ->
        send(command, {:relocated, changed})
        :ok

      error ->
        error
    end
  end

  defp skip_dataset(error, _file, _changed, true), do: {:halt, {:error, error}}

  defp skip_dataset(error, file, changed, false) do
    Output.warn("#{file} was not changed: #{error.what}")
    {:cont, {:ok, changed}}
  end

  defp delete_store(%{path: path}, opts) do
    folder = store_folder!(path)

    if opts[:yes] || confirm_deletion?(folder, count_segments(folder)) do
      :ok = unwrap!(Store.delete(folder))
      if opts[:json], do: Output.print_json(%{deleted: folder})
      0
    else
      Output.warn("Nothing deleted.")
      1
    end
  end

  # A store that is too damaged to open can still be deleted.
  defp store_folder!(path) do
    case Store.open(path) do
      {:ok, store} -> store.path
      {:error, error} -> if Store.exists?(path), do: Path.expand(path), else: raise(error)
    end
  end

  defp count_segments(folder) do
    case Store.open(folder) do
      {:ok, store} -> length(Store.segments(store))
      {:error, _} -> 0
    end
  end

  defp confirm_deletion?(folder, segments) do
    parts = if segments > 0, do: " and its #{Output.format_count(segments, "segment")}", else: ""
    answer = IO.gets("Delete #{Output.format_name(folder)}#{parts}? [y/N] ")
    is_binary(answer) and String.trim(answer) in ["y", "Y", "yes"]
  end

  defp unwrap!(:ok), do: :ok
  defp unwrap!({:ok, value}), do: value
  defp unwrap!({:error, error}), do: raise(error)
end

defmodule Situ.CLI.Store.Care do
  @moduledoc "The verbs of `situ store` that work on a store in its place: verify, repair, compact, delete, rename."
  @behaviour Situ.CLI.Verb
  alias Situ.CLI.{Option, Output, Progress, Recording, UnfinishedOutput, Verb}
  alias Situ.CLI.Store.{Arguments, Health}
  alias Situ.Store

  @store [kind: :recording, doc: "a store's folder, or ROOT/NAME for the newest NAME.NNNN"]

  @impl true
  def verbs do
    [
      %Verb{
        words: ["store", "verify"],
        aliases: ["doctor"],
        summary: "check every checksum; status 1 when anything is damaged",
        arguments: [path: Keyword.put(@store, :many, true)],
        examples: ["situ store verify 'recordings/*'"],
        run: fn %{path: paths}, opts -> Health.verify(Recording.expand(paths), opts) end
      },
      %Verb{
        words: ["store", "repair"],
        aliases: ["recover", "reindex"],
        summary: "repair a store that was not closed, or is damaged; sound data stays",
        about: """
        A store is repaired in its place. An MCAP file stays as it is: all messages that can be read, before and after
        the damage, are copied byte for byte into OUT, which has an index.
        """,
        arguments: [
          path: @store,
          out: [kind: :file, optional: true, doc: "of an MCAP file: the new one"]
        ],
        options: [Option.new(:dry_run, :flag, "only say what it would do")],
        examples: [
          "situ store repair recordings/lobby.0007",
          "situ store repair broken.mcap whole.mcap"
        ],
        run: fn %{path: path} = arguments, opts -> Health.repair(path, arguments[:out], opts) end
      },
      %Verb{
        words: ["store", "compact"],
        summary: "rewrite a store in its place, with full chunks instead of many small commits",
        about: """
        The recording becomes smaller and faster to read; its messages stay as they are. It keeps its name all the time,
        so nothing is lost if the program is killed. The disk needs room for a second copy. A store that is being
        written is refused.
        """,
        arguments: [path: Keyword.put(@store, :many, true)],
        options: [
          Option.new(:compression, ["none", "lz4", "zstd"], "of all streams; default: unchanged"),
          Option.new(
            :skip_damage,
            :flag,
            "leave out what is damaged; without it that is an error"
          )
        ],
        examples: ["situ store compact recordings/lobby.0000"],
        run: fn %{path: paths}, opts -> compact(Recording.expand(paths), opts) end
      },
      %Verb{
        words: ["store", "delete"],
        summary: "delete a store (asks first)",
        arguments: [path: @store],
        options: [Option.new(:yes, :flag, "do not ask", short: :y)],
        run: &delete/2
      },
      %Verb{
        words: ["store", "rename"],
        summary: "give a store another name",
        arguments: [path: @store, name: [kind: :text, doc: "its new name"]],
        examples: ["situ store rename recordings/lobby.0000 entrance"],
        run: &rename/2
      }
    ]
  end

  defp compact(paths, opts) do
    done =
      for path <- paths do
        folder = folder!(path)
        UnfinishedOutput.remove_store_at_exit(folder)
        before = Recording.size(folder)
        copying = Arguments.copying(opts, fn _, _ -> :ok end)

        Progress.show("compact", opts, fn progress ->
          ok!(Store.compact(folder, [progress: progress] ++ Keyword.delete(copying, :progress)))
        end)

        %{path: folder, before: before, size: Recording.size(folder)}
      end

    if opts[:json], do: Output.json(done), else: Enum.each(done, &print_compacted/1)
    0
  end

  defp print_compacted(%{path: path, before: before, size: size}),
    do: Output.puts("#{path}: #{Output.bytes(before)} before, #{Output.bytes(size)} now")

  defp rename(%{path: path, name: name}, opts) do
    path = ok!(Store.rename(path, name))
    if opts[:json], do: Output.json(%{path: path}), else: Output.puts(path)
    0
  end

  defp delete(%{path: path}, opts) do
    folder = folder!(path)

    if opts[:yes] || sure?(folder) do
      :ok = ok!(Store.delete(folder))
      if opts[:json], do: Output.json(%{deleted: folder})
      0
    else
      Output.warn("Nothing deleted.")
      1
    end
  end

  # A store too broken to be opened can still be deleted.
  defp folder!(path) do
    case Store.open(path) do
      {:ok, store} -> store.path
      {:error, error} -> if Store.exists?(path), do: Path.expand(path), else: raise(error)
    end
  end

  defp sure?(folder) do
    answer = IO.gets("Delete #{Output.name(folder)}? [y/N] ")
    is_binary(answer) and String.trim(answer) in ["y", "Y", "yes"]
  end

  defp ok!(:ok), do: :ok
  defp ok!({:ok, value}), do: value
  defp ok!({:error, error}), do: raise(error)
end

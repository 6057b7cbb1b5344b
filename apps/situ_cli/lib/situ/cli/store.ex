defmodule Situ.CLI.Store do
  @moduledoc "`situ store`: looks at recordings, checks, mends and cuts them."
  @behaviour Situ.CLI.Command

  alias Situ.CLI.Store.{Arguments, Health, Info, Messages, Progress}
  alias Situ.Store

  @switches [
    json: :boolean,
    from: :string,
    to: :string,
    start: :string,
    length: :string,
    stream: :keep,
    compression: :string,
    set: :keep,
    delete: :keep,
    number: :integer,
    yes: :boolean,
    quiet: :boolean,
    skip_damage: :boolean,
    dry_run: :boolean
  ]
  # What each verb takes beside --json and --quiet.
  @interval [:from, :to, :stream, :compression, :skip_damage]
  @verbs %{
    "info" => [:stream],
    "list" => [],
    "messages" => [:stream, :number, :from, :to, :skip_damage],
    "verify" => [],
    "repair" => [:dry_run],
    "crop" => [:start, :length | @interval],
    "copy" => @interval,
    "concat" => @interval,
    "edit" => [:set, :delete, :skip_damage],
    "delete" => [:yes],
    "rename" => []
  }

  @impl true
  def name, do: "store"

  @impl true
  def summary, do: "look at recordings, check, repair, cut, copy, edit them"

  @impl true
  def usage do
    """
    Usage: situ store VERB PATH ... [OPTIONS]

    PATH is a store's folder, ROOT/NAME for the newest NAME.NNNN, or a foreign file (WAV, CSV, video, sound).

      info PATH...                 streams, rates, gaps, sizes, durations, latency; of several, or a folder: a line each
                                   (--stream NAME: all that is known of one stream)
      messages PATH --stream NAME  prints messages: time, latency, data (--number N, default 10; --from, --to)
      verify PATH...               checks every checksum; status 1 when anything is damaged
      repair PATH                  makes an unclosed or damaged store whole (--dry-run: only tells what it would do)
      crop PATH OUT                a new store with an interval (--from/--to times, or --start/--length)
      copy PATH OUT                a new store with all or some streams (--stream, --compression, --from, --to)
      concat PATH PATH... OUT      one store out of several
      edit PATH OUT                a new store with changes: --set STREAM@TIME=JSON, --delete STREAM@TIME
      delete PATH                  deletes a store (asks, or --yes)
      rename PATH NAME             gives it another name

    OUT is ROOT/NAME; a new version NAME.NNNN is made, and has its name when it is whole: stopped half way (Ctrl-C), a
    NAME.*.unfinished is left, which the next of that name removes. Originals are never changed (but by repair, delete, rename).

      --from, --to TIME       ISO 8601, or nanoseconds since 1970; both ends included
      --start, --length SPAN  from the store's first message: 10s, 1.5m, 250ms, 1h
      --stream NAME           or a pattern ('Room.*'); may be given several times
      --compression KIND      none, lz4 or zstd
      --skip-damage           leaves out what is damaged; without it that is an error
      --json                  for programs: one JSON value on standard output (messages: one a line)
      --quiet                 no progress bar

    Exit status: 0 done, 1 failed or damage found, 2 wrong usage.

    Example: situ store crop recordings/lobby recordings/lunch --start 30m --length 10m
    """
  end

  @impl true
  def run(argv) do
    # Pictures and sound of recordings, and the readers of media files, come with this application.
    {:ok, _} = Application.ensure_all_started(:situ_media)

    case OptionParser.parse(argv, strict: @switches, aliases: [s: :stream, n: :number, y: :yes]) do
      {opts, [verb | paths], []} -> checked(verb, paths, opts)
      {_, [], []} -> wrong("which verb?")
      {_, _, [{switch, _} | _]} -> wrong("unknown or wrong option #{switch}")
    end
  end

  # What an option cannot do it is not silently let do.
  defp checked(verb, paths, opts) do
    allowed = @verbs[verb] && [:json, :quiet | @verbs[verb]]

    case allowed && Enum.find(Keyword.keys(opts), &(&1 not in allowed)) do
      nil -> verb(verb, paths, opts)
      option -> wrong("--#{option} says nothing to #{verb}")
    end
  end

  defp verb("list", paths, opts), do: verb("info", paths, opts)
  defp verb("info", [_ | _] = paths, opts), do: Info.run(paths, opts)
  defp verb("messages", [path], opts), do: messages(path, opts)
  defp verb("verify", [_ | _] = paths, opts), do: Health.verify(paths, opts)
  defp verb("repair", [path], opts), do: Health.repair(path, opts)

  defp verb("crop", [from, to], opts) do
    if Keyword.take(opts, [:from, :to, :start, :length]) == [],
      do: wrong("crop to what? Give --start and --length, or --from and --to"),
      else: made(opts, &Store.crop(from, to, Arguments.copying(opts, &1)))
  end

  defp verb("copy", [from, to], opts),
    do: made(opts, &Store.copy(from, to, Arguments.copying(opts, &1)))

  defp verb("concat", [_, _ | _] = paths, opts) do
    {from, [to]} = Enum.split(paths, -1)
    made(opts, &Store.concat(from, to, Arguments.copying(opts, &1)))
  end

  defp verb("edit", [from, to], opts) do
    case Arguments.edits!(Store.open!(from), opts) do
      none when none == %{} -> wrong("which changes? Give --set or --delete")
      edits -> made(opts, &Store.edit(from, to, edits, Arguments.damage(opts) ++ [progress: &1]))
    end
  end

  defp verb("delete", [path], opts), do: delete(path, opts)

  defp verb("rename", [path, name], opts),
    do: made(opts, fn _ -> Store.rename(path, name) end)

  defp verb(verb, _paths, _opts) when is_map_key(@verbs, verb),
    do: wrong("wrong number of paths for #{verb}")

  defp verb(verb, _paths, _opts) do
    case Situ.Options.nearest(verb, Map.keys(@verbs)) do
      nil -> wrong("there is no verb #{inspect(verb)}")
      near -> wrong("there is no verb #{inspect(verb)}; did you mean #{near}?")
    end
  end

  defp wrong(text) do
    IO.puts(:stderr, "situ store: #{text}\n  Fix: see `situ store --help`")
    2
  end

  defp messages(path, opts) do
    case opts[:stream] do
      nil -> wrong("which stream? Give --stream NAME")
      name -> Messages.run(Store.open!(path), name, Arguments.times(opts), opts)
    end
  end

  defp made(opts, make) do
    path = Progress.show("write", opts, fn progress -> ok!(make.(progress)) end)
    IO.puts(if opts[:json], do: Situ.JSON.encode(%{path: path}), else: path)
    if opts[:from] || opts[:to] || opts[:start] || opts[:length], do: tell_empty(path)
    0
  end

  # Nothing wrong with an empty interval, but most likely somebody has mistaken the time.
  defp tell_empty(path) do
    if Store.interval(Store.open!(path)) == nil,
      do: IO.puts(:stderr, "No message lies in that interval: the new store is empty.")
  end

  defp delete(path, opts) do
    folder = folder!(path)

    if opts[:yes] || sure?(folder) do
      case Store.delete(folder) do
        :ok -> 0
        {:error, error} -> raise error
      end
    else
      IO.puts(:stderr, "Nothing deleted.")
      1
    end
  end

  # One too broken to be opened can be deleted all the same.
  defp folder!(path) do
    case Store.open(path) do
      {:ok, store} -> store.path
      {:error, error} -> if Store.exists?(path), do: Path.expand(path), else: raise(error)
    end
  end

  defp sure?(folder) do
    answer = IO.gets("Delete #{folder}? [y/N] ")
    is_binary(answer) and String.trim(answer) in ["y", "Y", "yes"]
  end

  defp ok!({:ok, value}), do: value
  defp ok!({:error, error}), do: raise(error)
end

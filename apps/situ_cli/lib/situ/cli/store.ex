defmodule Situ.CLI.Store do
  @moduledoc "`situ store`: looks at recordings, checks, mends and cuts them."
  @behaviour Situ.CLI.Command

  alias Situ.{Error, Store}
  alias Situ.CLI.Store.{Info, Progress}

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
    recursive: :boolean,
    yes: :boolean,
    quiet: :boolean
  ]
  @compressions %{"none" => :none, "lz4" => :lz4, "zstd" => :zstd}

  @impl true
  def name, do: "store"

  @impl true
  def summary, do: "look at recordings, check, repair, cut, copy, edit them"

  @impl true
  def usage do
    """
    Usage: situ store VERB PATH ... [OPTIONS]

    PATH is a store's folder, ROOT/NAME for the newest NAME.NNNN, or a foreign file (WAV, CSV).

      info PATH                    streams, rates, gaps, sizes, durations, latency; a folder: the stores in it
      messages PATH --stream NAME  prints messages: time, latency, data (--number N, default 10; --from, --to)
      verify PATH                  checks every checksum; status 1 when anything is damaged
      repair PATH                  makes an unclosed or damaged store whole
      crop PATH OUT                a new store with an interval (--from/--to times, or --start/--length)
      copy PATH OUT                a new store with all or some streams (--stream, --compression, --from, --to)
      concat PATH PATH... OUT      one store out of several
      edit PATH OUT                a new store with changes: --set STREAM@TIME=JSON, --delete STREAM@TIME
      delete PATH                  deletes a store (asks, or --yes)
      rename PATH NAME             gives it another name

    OUT is ROOT/NAME; a new version NAME.NNNN is made. Originals are never changed (but by repair, delete and rename).

      --from, --to TIME       ISO 8601, or nanoseconds since 1970
      --start, --length SPAN  from the store's first message: 10s, 1.5m, 250ms, 1h
      --stream NAME           may be given several times
      --compression KIND      none, lz4 or zstd
      --json                  one JSON value on standard output, for programs
      --quiet                 no progress bar

    Exit status: 0 done, 1 failed or damage found, 2 wrong usage.

    Example: situ store crop recordings/lobby recordings/lunch --start 30m --length 10m
    """
  end

  @impl true
  def run(argv) do
    # Pictures and sound of recordings, and the readers of media files, come with this application.
    {:ok, _} = Application.ensure_all_started(:situ_media)

    case OptionParser.parse(argv, strict: @switches, aliases: [s: :stream, n: :number]) do
      {opts, [verb | args], []} -> verb(verb, args, opts)
      {_, [], []} -> wrong("which verb?")
      {_, _, [{switch, _} | _]} -> wrong("unknown or wrong option #{switch}")
    end
  end

  defp verb("info", [path], opts), do: Info.run(path, opts)
  defp verb("list", [path], opts), do: Info.run(path, opts)
  defp verb("messages", [path], opts), do: messages(path, opts)
  defp verb("verify", [path], opts), do: verify(path, opts)
  defp verb("repair", [path], opts), do: repair(path, opts)
  defp verb("crop", [from, to], opts), do: made(opts, &Store.crop(from, to, copying(opts, &1)))
  defp verb("copy", [from, to], opts), do: made(opts, &Store.copy(from, to, copying(opts, &1)))

  defp verb("concat", [_, _ | _] = paths, opts) do
    {from, [to]} = Enum.split(paths, -1)
    made(opts, &Store.concat(from, to, copying(opts, &1)))
  end

  defp verb("edit", [from, to], opts),
    do: made(opts, fn _ -> Store.edit(from, to, edits(opts)) end)

  defp verb("delete", [path], opts), do: delete(path, opts)

  defp verb("rename", [path, name], opts),
    do: made(opts, fn _ -> Store.rename(path, name) end)

  defp verb(verb, _args, _opts)
       when verb in ~w(info list messages verify repair crop copy concat edit delete rename),
       do: wrong("wrong number of paths for #{verb}")

  defp verb(verb, _args, _opts) do
    verbs = ~w(info messages verify repair crop copy concat edit delete rename)

    case Situ.Options.nearest(verb, verbs) do
      nil -> wrong("there is no verb #{inspect(verb)}")
      near -> wrong("there is no verb #{inspect(verb)}; did you mean #{near}?")
    end
  end

  defp wrong(text) do
    IO.puts(:stderr, "situ store: #{text}\n  Fix: see `situ store --help`")
    2
  end

  defp messages(path, opts) do
    store = Store.open!(path)

    name =
      opts[:stream] || raise Error.new(:missing_option, "which stream?", fix: "--stream NAME")

    span = for {key, text} <- Keyword.take(opts, [:from, :to]), do: {key, time!(text)}

    store
    |> Store.messages(name, [{:skip_damage, true} | span])
    |> Enum.take(opts[:number] || 10)
    |> Enum.each(&IO.puts(line(&1, opts)))

    0
  end

  defp line(message, opts) do
    shown = inspect(message.data, limit: 20, printable_limit: 200)

    if opts[:json] do
      Situ.JSON.encode(%{
        originating_time: message.originating_time,
        creation_time: message.creation_time,
        sequence_id: message.sequence_id,
        data: shown
      })
    else
      latency = Situ.Time.format_duration(Situ.Message.latency(message))
      "#{Situ.Time.to_iso8601(message.originating_time)}  +#{latency}  #{shown}"
    end
  end

  defp verify(path, opts) do
    %{chunks: chunks, damage: damage} =
      Progress.show("verify", opts, fn progress ->
        ok!(Store.verify(path, progress: progress))
      end)

    if opts[:json] do
      IO.puts(Situ.JSON.encode(%{chunks: chunks, damage: damage}))
    else
      IO.puts(if damage == [], do: "#{chunks} chunks, all sound", else: "DAMAGED")
      Enum.each(damage, &IO.puts("  #{&1.file} at byte #{&1.offset}: #{&1.why}"))
      if damage != [], do: IO.puts("`situ store repair #{path}` keeps what is sound.")
    end

    if damage == [], do: 0, else: 1
  end

  defp repair(path, opts) do
    report =
      Progress.show("repair", opts, fn progress -> ok!(Store.repair(path, progress: progress)) end)

    if opts[:json] do
      IO.puts(Situ.JSON.encode(report))
    else
      IO.puts("#{report.kept} chunks kept, #{report.dropped} dropped")
      Enum.each(report.damage, &IO.puts("  #{&1.file} at byte #{&1.offset}: #{&1.why}"))

      if report.rebuilt?,
        do: IO.puts("The old index, if there was one, is index.situ.before-repair.")
    end

    0
  end

  defp made(opts, make) do
    path = Progress.show("write", opts, fn progress -> ok!(make.(progress)) end)
    IO.puts(if opts[:json], do: Situ.JSON.encode(%{path: path}), else: path)
    0
  end

  defp delete(path, opts) do
    folder = Store.open!(path).path

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

  defp sure?(folder) do
    answer = IO.gets("Delete #{folder}? [y/N] ")
    is_binary(answer) and String.trim(answer) in ["y", "Y", "yes"]
  end

  defp copying(opts, progress) do
    times = for {key, text} <- Keyword.take(opts, [:from, :to]), do: {key, time!(text)}
    spans = for {key, text} <- Keyword.take(opts, [:start, :length]), do: {key, span!(text)}
    streams = Keyword.get_values(opts, :stream)

    [{:progress, progress} | times ++ spans] ++
      if(streams == [], do: [], else: [streams: streams]) ++ compression(opts[:compression])
  end

  defp compression(nil), do: []

  defp compression(text) do
    case @compressions do
      %{^text => kind} ->
        [compression: kind]

      _ ->
        raise Error.new(:bad_option, "no compression #{inspect(text)}", fix: "none, lz4 or zstd")
    end
  end

  defp edits(opts) do
    sets = for text <- Keyword.get_values(opts, :set), do: set!(text)
    deletes = for text <- Keyword.get_values(opts, :delete), do: place!(text, :delete)
    Enum.group_by(sets ++ deletes, &elem(&1, 0), &elem(&1, 1))
  end

  defp set!(text) do
    with [place, json] <- String.split(text, "=", parts: 2),
         {stream, {:delete, time}} <- place!(place, :delete) do
      {stream, {:upsert, time, json!(json)}}
    else
      _ -> raise Error.new(:bad_option, "not an edit: #{text}", fix: "--set STREAM@TIME=JSON")
    end
  end

  defp json!(text) do
    case Situ.JSON.decode(text) do
      {:ok, value} ->
        value

      {:error, :bad_json} ->
        fix = "put strings into quotes: '\"text\"'"
        raise Error.new(:bad_option, "not JSON: #{text}", fix: fix)
    end
  end

  defp place!(text, kind) do
    case text |> String.reverse() |> String.split("@", parts: 2) |> Enum.map(&String.reverse/1) do
      [time, stream] -> {stream, {kind, time!(time)}}
      _ -> raise Error.new(:bad_option, "not a place: #{text}", fix: "write STREAM@TIME")
    end
  end

  @doc false
  def time!(text) do
    case Integer.parse(text) do
      {ns, ""} -> ns
      _ -> ok!(Situ.Time.parse(text))
    end
  end

  @units %{"ns" => 1, "us" => 1_000, "ms" => 1_000_000, "s" => 1_000_000_000}
         |> Map.merge(%{"m" => 60_000_000_000, "h" => 3_600_000_000_000})

  defp span!(text) do
    with {number, unit} <- Float.parse(text),
         {:ok, ns} <- Map.fetch(@units, if(unit == "", do: "s", else: unit)) do
      round(number * ns)
    else
      _ ->
        raise Error.new(:bad_option, "not a span of time: #{text}",
                fix: "write 10s, 250ms, 1.5m, 1h"
              )
    end
  end

  defp ok!({:ok, value}), do: value
  defp ok!({:error, error}), do: raise(error)
end

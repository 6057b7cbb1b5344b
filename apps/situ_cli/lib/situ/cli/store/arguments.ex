defmodule Situ.CLI.Store.Arguments do
  @moduledoc false
  # Parses times, spans, streams and edits as users write them.
  alias Situ.CLI.{Option, Recording}
  alias Situ.{Error, Store, Time}

  @compressions %{"none" => :none, "lz4" => :lz4, "zstd" => :zstd}

  @doc "Returns the options `--stream`, with this description, and `--exclude`."
  @spec streams(String.t()) :: [Option.t()]
  def streams(about \\ "this stream, or a pattern ('Room.*')") do
    [Option.new(:stream, :string, about, short: :s, value: "NAME", many?: true), exclude()]
  end

  @doc "Returns the option `--exclude`."
  @spec exclude() :: Option.t()
  def exclude do
    Option.new(:exclude, :string, "exclude this stream or pattern",
      short: :x,
      value: "NAME",
      many?: true
    )
  end

  @doc "Returns the options `--attach` and `--metadata`, which add attachments and metadata to an MCAP file."
  @spec carried() :: [Option.t()]
  def carried do
    [
      Option.new(:attach, :path, "MCAP: attach this file", value: "FILE", many?: true),
      Option.new(:metadata, :string, "MCAP: add this entry to a metadata record",
        value: "RECORD:KEY=VALUE",
        many?: true
      )
    ]
  end

  @doc "Parses the values of `--metadata` and groups them by record."
  @spec records!([String.t()]) :: %{String.t() => %{String.t() => String.t()}}
  def records!(texts) do
    for text <- texts, reduce: %{} do
      records ->
        case Regex.run(~r/\A([^:=]+):([^=]+)=(.*)\z/s, text) do
          [_, record, key, value] ->
            Map.update(records, record, %{key => value}, &Map.put(&1, key, value))

          nil ->
            raise bad("invalid metadata: #{text}", "write --metadata RECORD:KEY=VALUE")
        end
    end
  end

  @doc "Returns the options of `Situ.Store.copy/3` and similar functions."
  @spec copying(keyword(), function()) :: keyword()
  def copying(opts, progress) do
    spans = Keyword.take(opts, [:start, :length])
    streams = chosen(opts[:stream] || [], opts[:exclude] || [])

    stamps = %{"header" => [times: :header], "record" => [times: :record]}
    spans = spans ++ Map.get(stamps, opts[:times], [])

    [{:progress, progress} | damage(opts) ++ times(opts) ++ spans] ++
      streams ++ compression(opts[:compression])
  end

  @doc "Returns the option `skip_damage:`, which is false unless the user gave the flag."
  @spec damage(keyword()) :: keyword()
  def damage(opts), do: [skip_damage: opts[:skip_damage] == true]

  @doc "Returns the options `from:` and `to:`."
  @spec times(keyword()) :: keyword()
  def times(opts),
    do: Keyword.take(opts, [:from, :to])

  @doc "Converts `--start` and `--length` to `from:` and `to:`. Raises if the interval ends before it begins."
  @spec absolute_interval!(Path.t(), keyword()) :: keyword()
  def absolute_interval!(path, opts) do
    {first, _last} = path |> Recording.open!() |> Store.interval() || {0, 0}
    from = opts[:from] || first + (opts[:start] || 0)
    to = opts[:to] || (opts[:length] && from + opts[:length])

    if to && to < from,
      do: raise(Error.new(:bad_interval, "the interval ends before it begins"))

    Keyword.merge(opts, from: from, to: to)
  end

  defp compression(nil), do: []

  defp compression(text) do
    case @compressions do
      %{^text => kind} -> [compression: kind]
      _ -> raise bad("unknown compression #{inspect(text)}", "use none, lz4 or zstd")
    end
  end

  @doc "Parses `--set` and `--delete`, groups them by stream, and converts values to the types of this store's streams."
  @spec edits!(Store.Handle.t(), keyword()) :: %{String.t() => [tuple()]}
  def edits!(store, opts) do
    sets = for text <- opts[:set], do: set!(store, text)
    deletes = for text <- opts[:delete], do: delete!(store, text)
    Enum.group_by(sets ++ deletes, &elem(&1, 0), &elem(&1, 1))
  end

  defp set!(store, text) do
    case String.split(text, "=", parts: 2) do
      [place, json] ->
        {stream, time} = place!(place)
        {stream, {:upsert, time, fit(store, stream, json!(json))}}

      _ ->
        raise bad("invalid edit: #{text}", "write --set STREAM@TIME=JSON")
    end
  end

  # The value 5 for a stream of floats means 5.0.
  defp fit(store, stream, value) when is_integer(value) do
    case Store.stream_info(store, stream) do
      {:ok, %{type: :float}} -> value / 1
      _ -> value
    end
  end

  defp fit(_store, _stream, value), do: value

  # Deleting a message that does not exist usually means that the time is wrong.
  defp delete!(store, text) do
    {stream, time} = place!(text)

    case Store.first_at(store, stream, time) do
      {:ok, %{originating_time: ^time}} -> {stream, {:delete, time}}
      {:ok, next} -> raise nothing_there(stream, time, next)
      {:error, error} -> raise error
    end
  end

  defp nothing_there(stream, time, next) do
    fix = if next, do: "the next message is at #{Time.to_iso8601(next.originating_time)}"

    Error.new(:no_message, "stream #{inspect(stream)} has no message at #{Time.to_iso8601(time)}",
      fix: fix || "run `situ store messages` to list the times"
    )
  end

  defp json!(text) do
    case Situ.JSON.decode(text) do
      {:ok, value} ->
        value

      {:error, :bad_json} ->
        raise bad("invalid JSON: #{text}", "put strings in quotes: '\"text\"'")
    end
  end

  # The last "@" separates stream and time, because names may contain others.
  defp place!(text) do
    case text |> String.reverse() |> String.split("@", parts: 2) |> Enum.map(&String.reverse/1) do
      [time, stream] -> {stream, time!(time)}
      _ -> raise bad("not a stream and time: #{text}", "write STREAM@TIME")
    end
  end

  defp time!(text) do
    with :error <- whole(text), {:error, error} <- Time.parse(Option.complete_time(text)) do
      raise error
    else
      {:ok, time} -> time
    end
  end

  defp whole(text) do
    case Integer.parse(text) do
      {ns, ""} -> {:ok, ns}
      _ -> :error
    end
  end

  # Returns a filter for the wanted names and patterns without the unwanted ones.
  defp chosen([], []), do: []
  defp chosen(wanted, []), do: [streams: wanted]

  defp chosen(wanted, unwanted) do
    wanted = Enum.map(if(wanted == [], do: ["*"], else: wanted), &pattern/1)
    unwanted = Enum.map(unwanted, &pattern/1)

    fits? = fn name, patterns -> Enum.any?(patterns, &(name =~ &1)) end
    [streams: fn %{name: name} -> fits?.(name, wanted) and not fits?.(name, unwanted) end]
  end

  @doc "Returns the streams that `--stream` and `--exclude` select (default: all). Raises if a name matches no stream."
  @spec chosen!(Store.Handle.t(), keyword()) :: [Store.StreamInfo.t()]
  def chosen!(store, opts) do
    all = Store.streams(store)

    case chosen(opts[:stream] || [], opts[:exclude] || [])[:streams] do
      nil -> all
      fits? when is_function(fits?) -> Enum.filter(all, fits?)
      names -> names |> Enum.flat_map(&matching!(store, all, &1)) |> Enum.uniq()
    end
  end

  # An exact name takes precedence, because a name may look like a pattern.
  defp matching!(store, all, name) do
    case {Enum.find(all, &(&1.name == name)), Enum.filter(all, &fits?(&1.name, name))} do
      {%{} = exact, _} -> [exact]
      {nil, [_ | _] = found} -> found
      {nil, []} -> [Error.unwrap!(Store.stream_info(store, name))]
    end
  end

  @doc "Returns whether a stream's name is equal to the pattern or matches it."
  @spec fits?(String.t(), String.t()) :: boolean()
  def fits?(name, pattern), do: name =~ pattern(pattern)

  defp pattern(text) do
    source =
      Regex.replace(~r/[*?]|[^*?]+/u, text, fn
        "*" -> ".*"
        "?" -> "."
        other -> Regex.escape(other)
      end)

    Regex.compile!("\\A" <> source <> "\\z", "su")
  end

  defp bad(what, fix), do: Error.new(:bad_option, what, fix: fix)
end

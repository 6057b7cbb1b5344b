defmodule Situ.CLI.Store.Arguments do
  @moduledoc false
  # Parses times, spans, streams and edits as users write them.
  alias Situ.CLI.{Option, Recording}
  alias Situ.{Error, Store, Time}

  @compressions %{"none" => :none, "lz4" => :lz4, "zstd" => :zstd}

  @doc "Returns the options `--stream`, with this description, and `--exclude`."
  @spec stream_options(String.t()) :: [Option.t()]
  def stream_options(about \\ "this stream, or a pattern ('Room.*')") do
    [Option.new(:stream, :string, about, short: :s, value: "NAME", many?: true), exclude_option()]
  end

  @doc "Returns the option `--exclude`."
  @spec exclude_option() :: Option.t()
  def exclude_option do
    Option.new(:exclude, :string, "exclude this stream or pattern",
      short: :x,
      value: "NAME",
      many?: true
    )
  end

  @doc "Returns the option `--nested`."
  @spec nested_option() :: Option.t()
  def nested_option do
    Option.new(
      :nested,
      :flag,
      "Parquet: write maps and lists as nested columns, not lists as JSON text"
    )
  end

  @doc "Returns the options `--attach` and `--metadata`, which add attachments and metadata to an MCAP file."
  @spec mcap_options() :: [Option.t()]
  def mcap_options do
    [
      Option.new(:attach, :path, "MCAP: attach this file", value: "FILE", many?: true),
      Option.new(:metadata, :string, "MCAP: add this entry to a metadata record",
        value: "RECORD:KEY=VALUE",
        many?: true
      )
    ]
  end

  @doc "Parses the values of `--metadata` and groups them by record."
  @spec parse_records!([String.t()]) :: %{String.t() => %{String.t() => String.t()}}
  def parse_records!(texts) do
    for text <- texts, reduce: %{} do
      records ->
        case Regex.run(~r/\A([^:=]+):([^=]+)=(.*)\z/s, text) do
          [_, record, key, value] ->
            Map.update(records, record, %{key => value}, &Map.put(&1, key, value))

          nil ->
            raise bad_option("invalid metadata: #{text}", "write --metadata RECORD:KEY=VALUE")
        end
    end
  end

  @doc "Returns the options of `Situ.Store.copy/3` and similar functions."
  @spec copy_options(keyword(), function()) :: keyword()
  def copy_options(opts, progress) do
    spans = Keyword.take(opts, [:start, :length])
    streams = stream_filter(opts[:stream] || [], opts[:exclude] || [])

    stamps = %{"header" => [times: :header], "record" => [times: :record]}
    spans = spans ++ Map.get(stamps, opts[:times], [])

    [{:progress, progress} | damage_options(opts) ++ time_options(opts) ++ spans] ++
      streams ++ compression_option(opts[:compression])
  end

  @doc "Returns the option `skip_damage:`, which is false unless the user gave the flag."
  @spec damage_options(keyword()) :: keyword()
  def damage_options(opts), do: [skip_damage: opts[:skip_damage] == true]

  @doc "Returns the options `from:` and `to:`."
  @spec time_options(keyword()) :: keyword()
  def time_options(opts),
    do: Keyword.take(opts, [:from, :to])

  @doc "Converts `--start` and `--length` to `from:` and `to:`. Raises if the interval ends before it begins."
  @spec parse_interval!(Path.t(), keyword()) :: keyword()
  def parse_interval!(path, opts) do
    {first, _last} = path |> Recording.open!() |> Store.interval() || {0, 0}
    from = opts[:from] || first + (opts[:start] || 0)
    to = opts[:to] || (opts[:length] && from + opts[:length])

    if to && to < from,
      do: raise(Error.new(:bad_interval, "the interval ends before it begins"))

    Keyword.merge(opts, from: from, to: to)
  end

  defp compression_option(nil), do: []

  defp compression_option(text) do
    case @compressions do
      %{^text => kind} -> [compression: kind]
      _ -> raise bad_option("unknown compression #{inspect(text)}", "use none, lz4 or zstd")
    end
  end

  @doc "Parses `--set` and `--delete`, groups them by stream, and converts values to the types of this store's streams."
  @spec parse_edits!(Store.t(), keyword()) :: %{String.t() => [tuple()]}
  def parse_edits!(store, opts) do
    sets = for text <- opts[:set], do: parse_upsert!(store, text)
    deletes = for text <- opts[:delete], do: parse_deletion!(store, text)
    Enum.group_by(sets ++ deletes, &elem(&1, 0), &elem(&1, 1))
  end

  defp parse_upsert!(store, text) do
    case String.split(text, "=", parts: 2) do
      [position, json] ->
        {stream, time} = parse_position!(position)
        {stream, {:upsert, time, fit_type(store, stream, parse_json!(json))}}

      _ ->
        raise bad_option("invalid edit: #{text}", "write --set STREAM@TIME=JSON")
    end
  end

  # The value 5 for a stream of floats means 5.0.
  defp fit_type(store, stream, value) when is_integer(value) do
    case Store.stream_info(store, stream) do
      {:ok, %{type: :float}} -> value / 1
      _ -> value
    end
  end

  defp fit_type(_store, _stream, value), do: value

  # Deleting a message that does not exist usually means that the time is wrong.
  defp parse_deletion!(store, text) do
    {stream, time} = parse_position!(text)

    case Store.first_at(store, stream, time) do
      {:ok, %{originating_time: ^time}} -> {stream, {:delete, time}}
      {:ok, next} -> raise missing_message_error(stream, time, next)
      {:error, error} -> raise error
    end
  end

  defp missing_message_error(stream, time, next) do
    fix = if next, do: "the next message is at #{Time.to_iso8601(next.originating_time)}"

    Error.new(:no_message, "stream #{inspect(stream)} has no message at #{Time.to_iso8601(time)}",
      fix: fix || "run `situ store messages` to list the times"
    )
  end

  defp parse_json!(text) do
    case Situ.JSON.decode(text) do
      {:ok, value} ->
        value

      {:error, :bad_json} ->
        raise bad_option("invalid JSON: #{text}", "put strings in quotes: '\"text\"'")
    end
  end

  # The last "@" separates stream and time, because names may contain others.
  defp parse_position!(text) do
    case text |> String.reverse() |> String.split("@", parts: 2) |> Enum.map(&String.reverse/1) do
      [time, stream] -> {stream, parse_time!(time)}
      _ -> raise bad_option("not a stream and time: #{text}", "write STREAM@TIME")
    end
  end

  defp parse_time!(text) do
    with :error <- parse_nanoseconds(text),
         {:error, error} <- Time.parse(Option.complete_time(text)) do
      raise error
    else
      {:ok, time} -> time
    end
  end

  defp parse_nanoseconds(text) do
    case Integer.parse(text) do
      {ns, ""} -> {:ok, ns}
      _ -> :error
    end
  end

  # Returns a filter for the wanted names and patterns without the unwanted ones.
  defp stream_filter([], []), do: []
  defp stream_filter(wanted, []), do: [streams: wanted]

  defp stream_filter(wanted, unwanted) do
    wanted = Enum.map(if(wanted == [], do: ["*"], else: wanted), &pattern_regex/1)
    unwanted = Enum.map(unwanted, &pattern_regex/1)

    fits? = fn name, patterns -> Enum.any?(patterns, &(name =~ &1)) end
    [streams: fn %{name: name} -> fits?.(name, wanted) and not fits?.(name, unwanted) end]
  end

  @doc "Returns the streams that `--stream` and `--exclude` select (default: all). Raises if a name matches no stream."
  @spec select_streams!(Store.t(), keyword()) :: [Store.StreamInfo.t()]
  def select_streams!(store, opts) do
    all = Store.streams(store)

    case stream_filter(opts[:stream] || [], opts[:exclude] || [])[:streams] do
      nil -> all
      fits? when is_function(fits?) -> Enum.filter(all, fits?)
      names -> names |> Enum.flat_map(&matching_streams!(store, all, &1)) |> Enum.uniq()
    end
  end

  # An exact name takes precedence, because a name may look like a pattern.
  defp matching_streams!(store, all, name) do
    case {Enum.find(all, &(&1.name == name)), Enum.filter(all, &name_matches?(&1.name, name))} do
      {%{} = exact, _} -> [exact]
      {nil, [_ | _] = streams} -> streams
      {nil, []} -> [Error.unwrap!(Store.stream_info(store, name))]
    end
  end

  @doc "Returns whether a stream's name is equal to the pattern or matches it."
  @spec name_matches?(String.t(), String.t()) :: boolean()
  def name_matches?(name, pattern), do: name =~ pattern_regex(pattern)

  defp pattern_regex(text) do
    source =
      Regex.replace(~r/[*?]|[^*?]+/u, text, fn
        "*" -> ".*"
        "?" -> "."
        other -> Regex.escape(other)
      end)

    Regex.compile!("\\A" <> source <> "\\z", "su")
  end

  defp bad_option(what, fix), do: Error.new(:bad_option, what, fix: fix)
end

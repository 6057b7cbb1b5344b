defmodule Situ.CLI.Store.Arguments do
  @moduledoc false
  # Times, spans, streams and edits as people write them.
  alias Situ.{Error, Store, Time}

  @compressions %{"none" => :none, "lz4" => :lz4, "zstd" => :zstd}
  @units %{"ns" => 1, "us" => 1_000, "ms" => 1_000_000, "s" => 1_000_000_000}
         |> Map.merge(%{"m" => 60_000_000_000, "min" => 60_000_000_000, "h" => 3_600_000_000_000})

  @doc "The options of `Situ.Store.copy/3` and its like."
  @spec copying(keyword(), function()) :: keyword()
  def copying(opts, progress) do
    spans = for {key, text} <- Keyword.take(opts, [:start, :length]), do: {key, span!(text)}
    streams = Keyword.get_values(opts, :stream)

    [{:progress, progress} | damage(opts) ++ times(opts) ++ spans] ++
      if(streams == [], do: [], else: [streams: streams]) ++ compression(opts[:compression])
  end

  @doc "Nothing is left out unless the caller says so."
  @spec damage(keyword()) :: keyword()
  def damage(opts), do: [skip_damage: opts[:skip_damage] == true]

  @doc "`from:` and `to:`."
  @spec times(keyword()) :: keyword()
  def times(opts),
    do: for({key, text} <- Keyword.take(opts, [:from, :to]), do: {key, time!(text)})

  defp compression(nil), do: []

  defp compression(text) do
    case @compressions do
      %{^text => kind} -> [compression: kind]
      _ -> raise bad("no compression #{inspect(text)}", "none, lz4 or zstd")
    end
  end

  @doc "`--set` and `--delete` by stream, fit for the streams of this store."
  @spec edits!(Store.t(), keyword()) :: %{String.t() => [tuple()]}
  def edits!(store, opts) do
    sets = for text <- Keyword.get_values(opts, :set), do: set!(store, text)
    deletes = for text <- Keyword.get_values(opts, :delete), do: delete!(store, text)
    Enum.group_by(sets ++ deletes, &elem(&1, 0), &elem(&1, 1))
  end

  defp set!(store, text) do
    case String.split(text, "=", parts: 2) do
      [place, json] ->
        {stream, time} = place!(place)
        {stream, {:upsert, time, fit(store, stream, json!(json))}}

      _ ->
        raise bad("not an edit: #{text}", "--set STREAM@TIME=JSON")
    end
  end

  # Who writes 5 into a stream of floats means 5.0.
  defp fit(store, stream, value) when is_integer(value) do
    case Store.stream_info(store, stream) do
      {:ok, %{type: :float}} -> value / 1
      _ -> value
    end
  end

  defp fit(_store, _stream, value), do: value

  # Who deletes what is not there has mistaken the time.
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
      fix: fix || "`situ store messages` shows the times there are"
    )
  end

  defp json!(text) do
    case Situ.JSON.decode(text) do
      {:ok, value} -> value
      {:error, :bad_json} -> raise bad("not JSON: #{text}", "put strings into quotes: '\"text\"'")
    end
  end

  # The last "@" is the one: names may have some.
  defp place!(text) do
    case text |> String.reverse() |> String.split("@", parts: 2) |> Enum.map(&String.reverse/1) do
      [time, stream] -> {stream, time!(time)}
      _ -> raise bad("not a place: #{text}", "write STREAM@TIME")
    end
  end

  defp time!(text) do
    with :error <- whole(text), {:error, error} <- Time.parse(text) do
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

  defp span!(text) do
    with {number, unit} <- Float.parse(text),
         {:ok, ns} <- Map.fetch(@units, if(unit == "", do: "s", else: unit)) do
      round(number * ns)
    else
      _ -> raise bad("not a span of time: #{text}", "write 10s, 250ms, 1.5m, 1h")
    end
  end

  defp bad(what, fix), do: Error.new(:bad_option, what, fix: fix)
end

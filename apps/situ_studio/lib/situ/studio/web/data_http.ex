defmodule Situ.Studio.Web.DataHttp do
  @moduledoc false
  # Data fetched over HTTP rather than streamed: windows for scripts and tests, audio, steps between messages, and
  # exported files.
  alias Situ.Live.{Request, Response}
  alias Situ.Scratch

  alias Situ.Studio.{
    Catalog,
    Comparison,
    Draw,
    Film,
    Frame,
    Path,
    Sound,
    Source,
    Thumbnail,
    Visualizers,
    WholeNumber
  }

  # The longest exported audio file is one hour.
  @longest_wav 3_600_000_000_000

  @spec call(Request.t(), {String.t(), atom()}) :: Response.t()
  def call(%Request{query: query}, {studio, :film}) do
    with {:ok, path} <- Film.Job.file(studio, query["key"]),
         {:ok, %{size: size}} <- File.stat(path) do
      file("video/mp4", "mp4", {:file, path, 0, size})
    else
      _ -> Response.error(404, "this video does not exist any more; export it again")
    end
  end

  def call(%Request{query: query}, {studio, what}) do
    with {:ok, _item, source, _} <- Comparison.open(studio, query["source"], query),
         {:ok, extent} <- Source.call(source, :extent, []) do
      answer(
        what,
        Map.put(query, :visualizers, Catalog.settings(studio).visualizers),
        source,
        extent
      )
    else
      {:error, error} -> Response.error(404, error.what)
    end
  end

  defp answer(:window, query, source, extent) do
    with {:ok, path} <- Path.parse(text(query["path"])),
         {:ok, from} <- WholeNumber.parse(query["from"] || Integer.to_string(extent.from)),
         {:ok, to} when to >= from <-
           WholeNumber.parse(query["to"] || Integer.to_string(extent.to)),
         {:ok, px} when px in 1..10_000 <- WholeNumber.parse(query["px"] || "1000"),
         {:ok, viz} <- Visualizers.named(query["viz"] || "line", query.visualizers) do
      spec = %{stream: text(query["stream"]), viz: viz, path: path}
      frame = Draw.window(source, 0, spec, from, to, max(div(to - from, px), 1))
      reply([frame], extent, extent.to)
    else
      _ -> bad()
    end
  end

  defp answer(:at, query, source, extent) do
    with {:ok, path} <- Path.parse(text(query["path"])),
         {:ok, time} <- WholeNumber.parse(query["at"]),
         {:ok, viz} <- Visualizers.named(query["viz"] || "value", query.visualizers) do
      spec = %{stream: text(query["stream"]), viz: viz, path: path}
      {frame, _} = Draw.instant(source, 0, spec, time, nil)
      reply([frame], extent, time)
    else
      _ -> bad()
    end
  end

  defp answer(:pcm, query, source, extent) do
    with {:ok, from} <- WholeNumber.parse(query["from"]),
         {:ok, to} <- WholeNumber.parse(query["to"]),
         {:ok, channel} <- channel(query["channel"] || "0") do
      case sound(source, text(query["stream"]), {from, to}, channel) do
        {:ok, {start, rate, channels, samples}} ->
          reply([Frame.pcm(0, start, rate, samples, channels)], extent, from)

        {:error, error} ->
          Response.error(422, error.what)
      end
    else
      _ -> bad()
    end
  end

  defp answer(:step, query, source, _extent) do
    with {:ok, at} <- WholeNumber.parse(query["at"]) do
      {name, time} =
        if query["dir"] == "previous", do: {:latest_at, at - 1}, else: {:next_after, at}

      case Source.call(source, name, [text(query["stream"]), time]) do
        {:ok, message} ->
          Response.json(%{"time" => Integer.to_string(message.originating_time)})

        _ ->
          Response.json(%{"time" => nil})
      end
    else
      _ -> bad()
    end
  end

  defp answer(:csv, query, source, _extent) do
    with {:ok, from} <- WholeNumber.parse(query["from"]),
         {:ok, to} when to >= from <- WholeNumber.parse(query["to"]),
         {:ok, [_ | _] = streams} <- Situ.JSON.decode(text(query["streams"])),
         true <- Enum.all?(streams, &is_binary/1) do
      body = {:chunks, Situ.Studio.Table.csv(source, streams, from, to)}
      file("text/csv; charset=utf-8", "csv", body)
    else
      _ -> bad()
    end
  end

  defp answer(:parquet, query, source, _extent) do
    with {:ok, from} <- WholeNumber.parse(query["from"]),
         {:ok, to} when to >= from <- WholeNumber.parse(query["to"]),
         {:ok, [_ | _] = streams} <- Situ.JSON.decode(text(query["streams"])),
         true <- Enum.all?(streams, &is_binary/1) do
      folder = Situ.Error.unwrap!(Scratch.create("table"))
      path = Elixir.Path.join(folder, "selection.parquet")

      # A Parquet file's index is at its end, so the file must be complete before its first byte is sent.
      case Situ.Studio.Table.parquet(source, streams, from, to, path) do
        {:ok, _rows} ->
          file("application/vnd.apache.parquet", "parquet", {:chunks, sent(path, folder)})

        {:error, error} ->
          Scratch.remove(folder)
          Response.error(422, Exception.message(error))
      end
    else
      _ -> bad()
    end
  end

  defp answer(:wav, query, source, _extent) do
    with {:ok, from} <- WholeNumber.parse(query["from"]),
         {:ok, to} when to > from and to - from <= @longest_wav <- WholeNumber.parse(query["to"]) do
      case Situ.Studio.Table.wav(source, text(query["stream"]), from, to) do
        {:ok, data} -> file("audio/wav", "wav", data)
        {:error, error} -> Response.error(422, error.what)
      end
    else
      _ -> bad()
    end
  end

  # The thumbnail of a finished recording does not change, so it may be cached longer.
  defp answer(:thumbnail, _query, source, extent) do
    case Thumbnail.of(source) do
      {:ok, type, data} ->
        age = if extent.live, do: 5, else: 300
        headers = [{"content-type", type}, {"cache-control", "private, max-age=#{age}"}]
        %Response{headers: headers, body: data}

      :none ->
        # Lists show this placeholder; the browser's broken-image icon would suggest an error.
        %Response{headers: [{"content-type", "image/svg+xml"}], body: Thumbnail.empty_svg()}
    end
  end

  defp channel("all"), do: {:ok, :all}
  defp channel(text), do: WholeNumber.parse(text)

  defp sound(source, stream, {from, to}, :all), do: Sound.frames(source, stream, from, to)

  defp sound(source, stream, {from, to}, channel) do
    with {:ok, {start, rate, samples}} <-
           Sound.samples(source, stream, from, to, max(channel, 0)),
         do: {:ok, {start, rate, 1, samples}}
  end

  # Streams a temporary file and deletes it afterwards.
  defp sent(path, folder) do
    Stream.resource(
      fn -> File.open!(path, [:raw, :binary, :read]) end,
      fn file ->
        case :file.read(file, 65_536) do
          {:ok, bytes} -> {[bytes], file}
          :eof -> {:halt, file}
        end
      end,
      fn file ->
        :ok = :file.close(file)
        Scratch.remove(folder)
      end
    )
  end

  defp file(type, ending, body) do
    headers = [
      {"content-type", type},
      {"content-disposition", "attachment; filename=\"selection.#{ending}\""},
      {"cache-control", "no-store"}
    ]

    %Response{headers: headers, body: body}
  end

  defp reply(frames, extent, time) do
    %{request: 0, from: extent.from, to: extent.to, time: time}
    |> Map.merge(Map.take(extent, [:live, :version]))
    |> then(&Frame.reply(frames, &1))
    |> Response.binary([{"cache-control", "no-store"}])
  end

  defp bad, do: Response.error(400, "invalid data request")

  # A query may hold a list or a map where a string is expected; such a value is ignored.
  defp text(value), do: if(is_binary(value), do: value, else: "")
end

defmodule Situ.Studio.Web.DataHttp do
  @moduledoc false
  # Serves data over HTTP that pages do not stream: windows for scripts and tests, audio, steps between messages, and
  # exported files.
  alias Situ.Live.{Request, Response}
  alias Situ.TempFolder

  alias Situ.Studio.{
    Catalog,
    Comparison,
    Draw,
    VideoExport,
    Frame,
    ValuePath,
    AudioSamples,
    Thumbnail,
    Visualizers,
    Int64,
    StreamReader
  }

  # The longest exported audio file is one hour.
  @longest_wav 3_600_000_000_000
  @exported_types %{"mp4" => "video/mp4", "html" => "text/html; charset=utf-8"}

  @spec call(Request.t(), {String.t(), atom()}) :: Response.t()
  def call(%Request{query: query}, {studio, :film}) do
    with {:ok, path} <- VideoExport.Job.fetch_file(studio, query["key"]),
         {:ok, %{size: size}} <- File.stat(path) do
      ending = path |> Elixir.Path.extname() |> String.trim_leading(".")
      file_response(@exported_types[ending], ending, {:file, path, 0, size})
    else
      _ -> Response.error(404, "this file does not exist any more; export it again")
    end
  end

  def call(%Request{query: query}, {studio, what}) do
    with {:ok, _item, source, _} <- Comparison.open_item(studio, query["source"], query),
         {:ok, extent} <- StreamReader.fetch_extent(source) do
      build_response(
        what,
        Map.put(query, :visualizers, Catalog.settings(studio).visualizers),
        source,
        extent
      )
    else
      {:error, error} -> Response.error(404, error.what)
    end
  end

  defp build_response(:window, query, source, extent) do
    with {:ok, path} <- ValuePath.parse(text_param(query["path"])),
         {:ok, from} <- Int64.parse(query["from"] || Integer.to_string(extent.from)),
         {:ok, to} when to >= from <-
           Int64.parse(query["to"] || Integer.to_string(extent.to)),
         {:ok, px} when px in 1..10_000 <- Int64.parse(query["px"] || "1000"),
         {:ok, viz} <- Visualizers.fetch_by_id(query["viz"] || "line", query.visualizers) do
      spec = %{stream: text_param(query["stream"]), viz: viz, path: path}
      frame = Draw.draw_window(source, 0, spec, from, to, max(div(to - from, px), 1))
      frames_response([frame], extent, extent.to)
    else
      _ -> bad_request()
    end
  end

  defp build_response(:at, query, source, extent) do
    with {:ok, path} <- ValuePath.parse(text_param(query["path"])),
         {:ok, time} <- Int64.parse(query["at"]),
         {:ok, viz} <- Visualizers.fetch_by_id(query["viz"] || "value", query.visualizers) do
      spec = %{stream: text_param(query["stream"]), viz: viz, path: path}
      {frame, _} = Draw.draw_instant(source, 0, spec, time, nil)
      frames_response([frame], extent, time)
    else
      _ -> bad_request()
    end
  end

  defp build_response(:pcm, query, source, extent) do
    with {:ok, from} <- Int64.parse(query["from"]),
         {:ok, to} <- Int64.parse(query["to"]),
         {:ok, channel} <- parse_channel(query["channel"] || "0") do
      case read_audio(source, text_param(query["stream"]), {from, to}, channel) do
        {:ok, {start, rate, channels, samples}} ->
          frames_response([Frame.pcm(0, start, rate, samples, channels)], extent, from)

        {:error, error} ->
          Response.error(422, error.what)
      end
    else
      _ -> bad_request()
    end
  end

  defp build_response(:step, query, source, _extent) do
    with {:ok, at} <- Int64.parse(query["at"]) do
      stream = text_param(query["stream"])

      found =
        if query["dir"] == "previous",
          do: StreamReader.latest_at(source, stream, at - 1),
          else: StreamReader.next_after(source, stream, at)

      case found do
        {:ok, message} ->
          Response.json(%{"time" => Integer.to_string(message.originating_time)})

        _ ->
          Response.json(%{"time" => nil})
      end
    else
      _ -> bad_request()
    end
  end

  defp build_response(:csv, query, source, _extent) do
    with {:ok, from} <- Int64.parse(query["from"]),
         {:ok, to} when to >= from <- Int64.parse(query["to"]),
         {:ok, [_ | _] = streams} <- Situ.JSON.decode(text_param(query["streams"])),
         true <- Enum.all?(streams, &is_binary/1) do
      body = {:chunks, Situ.Studio.TableExport.csv_chunks(source, streams, from, to)}
      file_response("text/csv; charset=utf-8", "csv", body)
    else
      _ -> bad_request()
    end
  end

  defp build_response(:parquet, query, source, _extent) do
    with {:ok, from} <- Int64.parse(query["from"]),
         {:ok, to} when to >= from <- Int64.parse(query["to"]),
         {:ok, [_ | _] = streams} <- Situ.JSON.decode(text_param(query["streams"])),
         true <- Enum.all?(streams, &is_binary/1) do
      folder = Situ.Error.unwrap!(TempFolder.create_folder("table"))
      path = Elixir.Path.join(folder, "selection.parquet")

      # A Parquet file's index is at its end, so the file must be complete before its first byte is sent.
      case Situ.Studio.TableExport.write_parquet(source, streams, from, to, path) do
        {:ok, _rows} ->
          file_response(
            "application/vnd.apache.parquet",
            "parquet",
            {:chunks, stream_file(path, folder)}
          )

        {:error, error} ->
          TempFolder.remove_folder(folder)
          Response.error(422, Exception.message(error))
      end
    else
      _ -> bad_request()
    end
  end

  defp build_response(:wav, query, source, _extent) do
    with {:ok, from} <- Int64.parse(query["from"]),
         {:ok, to} when to > from and to - from <= @longest_wav <- Int64.parse(query["to"]) do
      case Situ.Studio.TableExport.encode_wav(source, text_param(query["stream"]), from, to) do
        {:ok, data} -> file_response("audio/wav", "wav", data)
        {:error, error} -> Response.error(422, error.what)
      end
    else
      _ -> bad_request()
    end
  end

  # The thumbnail of a finished recording does not change, so it may be cached longer.
  defp build_response(:thumbnail, _query, source, extent) do
    case Thumbnail.render_thumbnail(source) do
      {:ok, type, data} ->
        age = if extent.live, do: 5, else: 300
        headers = [{"content-type", type}, {"cache-control", "private, max-age=#{age}"}]
        %Response{headers: headers, body: data}

      :none ->
        # Lists show this placeholder; the browser's broken-image icon would suggest an error.
        %Response{headers: [{"content-type", "image/svg+xml"}], body: Thumbnail.empty_svg()}
    end
  end

  defp parse_channel("all"), do: {:ok, :all}
  defp parse_channel(text), do: Int64.parse(text)

  defp read_audio(source, stream, {from, to}, :all),
    do: AudioSamples.interleaved_samples(source, stream, from, to)

  defp read_audio(source, stream, {from, to}, channel) do
    with {:ok, {start, rate, samples}} <-
           AudioSamples.channel_samples(source, stream, from, to, max(channel, 0)),
         do: {:ok, {start, rate, 1, samples}}
  end

  # Streams a temporary file and deletes it afterwards.
  defp stream_file(path, folder) do
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
        TempFolder.remove_folder(folder)
      end
    )
  end

  defp file_response(type, ending, body) do
    headers = [
      {"content-type", type},
      {"content-disposition", "attachment; filename=\"selection.#{ending}\""},
      {"cache-control", "no-store"}
    ]

    %Response{headers: headers, body: body}
  end

  defp frames_response(frames, extent, time) do
    %{request: 0, from: extent.from, to: extent.to, time: time}
    |> Map.merge(Map.take(extent, [:live, :version]))
    |> then(&Frame.encode_reply(frames, &1))
    |> Response.binary([{"cache-control", "no-store"}])
  end

  defp bad_request, do: Response.error(400, "invalid data request")

  # A query may hold a list or a map where a string is expected; such a value is ignored.
  defp text_param(value), do: if(is_binary(value), do: value, else: "")
end

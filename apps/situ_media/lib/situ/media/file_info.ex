defmodule Situ.Media.FileInfo do
  @moduledoc """
  Describes the contents of a media file without decoding it.

      {:ok, info} = Situ.Media.FileInfo.read("talk1.mp4")
      {info.video.width, info.video.height, info.audio.rate, info.duration}
      #=> {1024, 512, 16_000, 14_000_000_000}

    * `duration`: nanoseconds, or `nil` if the file does not state it
    * `recorded_at`: the recording time in nanoseconds since the epoch, or `nil`. It is exact for files written by
      `Situ.Media.VideoWriter`; for other files it is their `creation_time`
    * `exact?`: whether `recorded_at` is the exact originating time of media time 0
    * `video`: `%{index, codec, width, height, rate, duration}` or `nil`; `rate` is `{frames, seconds}` or `nil`
    * `audio`: `%{index, codec, rate, channels, duration}` or `nil`
  """
  alias Situ.{Error, Media.FFmpeg}

  @enforce_keys [:name, :format]
  defstruct [:name, :format, :duration, :recorded_at, :video, :audio, exact?: false]

  @type video :: %{
          index: non_neg_integer(),
          codec: String.t(),
          width: non_neg_integer(),
          height: non_neg_integer(),
          rate: {pos_integer(), pos_integer()} | nil,
          duration: Situ.Time.duration() | nil
        }
  @type audio :: %{
          index: non_neg_integer(),
          codec: String.t(),
          rate: pos_integer(),
          channels: pos_integer(),
          duration: Situ.Time.duration() | nil
        }
  @type t :: %__MODULE__{
          name: String.t(),
          format: String.t(),
          duration: Situ.Time.duration() | nil,
          recorded_at: Situ.Time.t() | nil,
          exact?: boolean(),
          video: video() | nil,
          audio: audio() | nil
        }

  # The tag that stores the exact originating time at which a recording starts.
  @tag "situ_start_time"
  @seconds 30
  @entries "format=format_name,duration:format_tags=creation_time,#{@tag}" <>
             ":stream=index,codec_type,codec_name,width,height,avg_frame_rate,r_frame_rate," <>
             "sample_rate,channels,duration:stream_disposition=attached_pic"

  @doc "Returns the name of the tag that stores the exact start time of a recording."
  @spec start_tag() :: String.t()
  def start_tag, do: @tag

  @doc """
  Probes the file at `path` and returns its contents. Gives up after 30 s.

      iex> {:error, error} = Situ.Media.FileInfo.read("no-such.mp4")
      iex> error.code
      :no_file
  """
  @spec read(Path.t()) :: {:ok, t()} | {:error, Error.t()}
  def read(path) do
    case File.stat(path) do
      {:ok, %{type: :regular}} -> probe_file(path)
      {:ok, %{type: type}} -> {:error, Error.new(:no_file, "#{inspect(path)} is a #{type}")}
      {:error, reason} -> {:error, no_file(path, reason)}
    end
  end

  defp probe_file(path) do
    # ffprobe ends on its own; `timeout` kills it if a malicious file keeps it busy.
    args =
      ~w(-k 1 #{@seconds}) ++
        ["ffprobe" | ~w(-hide_banner -loglevel quiet -of json -show_entries #{@entries})] ++
        FFmpeg.local_file(path)

    with {:ok, _} <- FFmpeg.fetch_executable("ffprobe") do
      {out, status} = System.cmd("timeout", args, stderr_to_stdout: false, env: [])
      parse_probe(out, status, path)
    end
  end

  defp parse_probe(out, 0, path) do
    {:ok, said} = Situ.JSON.decode(out)
    %{"format" => format, "streams" => streams} = Map.merge(%{"streams" => []}, said)

    # Matroska stores the names of tags in capitals.
    tags = Map.new(format["tags"] || %{}, fn {key, value} -> {String.downcase(key), value} end)
    exact = exact_start(tags[@tag])

    info = %__MODULE__{
      name: Path.basename(path),
      format: format["format_name"],
      duration: parse_duration(format["duration"]),
      recorded_at: exact || creation_time(tags["creation_time"]),
      exact?: exact != nil,
      video: Enum.find_value(streams, &parse_video/1),
      audio: Enum.find_value(streams, &parse_audio/1)
    }

    if info.video || info.audio,
      do: {:ok, info},
      else: {:error, unreadable_error(path, "the file contains neither images nor audio")}
  end

  defp parse_probe(_out, 124, path),
    do: {:error, unreadable_error(path, "probing the file took longer than #{@seconds} s")}

  defp parse_probe(_out, _status, path),
    do:
      {:error,
       unreadable_error(
         path,
         "FFmpeg does not recognize the format, or its headers are missing or damaged"
       )}

  defp parse_video(%{"codec_type" => "video"} = stream) do
    # The cover image of an audio file is not a video.
    if stream["disposition"]["attached_pic"] == 1 do
      nil
    else
      %{
        index: stream["index"],
        codec: stream["codec_name"] || "unknown",
        width: stream["width"] || 0,
        height: stream["height"] || 0,
        rate: parse_rate(stream["avg_frame_rate"]) || parse_rate(stream["r_frame_rate"]),
        duration: parse_duration(stream["duration"])
      }
    end
  end

  defp parse_video(_stream), do: nil

  defp parse_audio(
         %{"codec_type" => "audio", "sample_rate" => rate, "channels" => channels} = stream
       )
       when channels > 0 and rate != "0" do
    %{
      index: stream["index"],
      codec: stream["codec_name"] || "unknown",
      rate: String.to_integer(rate),
      channels: channels,
      duration: parse_duration(stream["duration"])
    }
  end

  defp parse_audio(_stream), do: nil

  defp parse_rate(nil), do: nil

  defp parse_rate(text) do
    case String.split(text, "/") |> Enum.map(&Integer.parse/1) do
      [{frames, ""}, {seconds, ""}] when frames > 0 and seconds > 0 -> {frames, seconds}
      _ -> nil
    end
  end

  # Parses decimal seconds exactly.
  defp parse_duration(nil), do: nil

  defp parse_duration(text) do
    case Regex.run(~r/^(\d{1,9})(?:\.(\d{1,9}))?$/, text) do
      [_, whole] -> String.to_integer(whole) * 1_000_000_000
      [_, whole, part] -> String.to_integer(whole <> String.pad_trailing(part, 9, "0"))
      nil -> nil
    end
  end

  defp exact_start(text) when is_binary(text) do
    case Integer.parse(text) do
      {time, ""} -> time
      _ -> nil
    end
  end

  defp exact_start(_), do: nil

  defp creation_time(text) when is_binary(text) do
    case Situ.Time.parse(text) do
      {:ok, time} -> time
      {:error, _} -> nil
    end
  end

  defp creation_time(_), do: nil

  defp no_file(path, reason) do
    Error.new(:no_file, "cannot open #{inspect(path)}: #{:file.format_error(reason)}",
      fix: "check the path; relative paths start at #{File.cwd!()}"
    )
  end

  defp unreadable_error(path, why) do
    Error.new(:unreadable_media, "cannot read #{Path.basename(path)}",
      why: why,
      fix: "check that the file is complete: ffprobe #{Path.basename(path)}",
      meta: %{path: path}
    )
  end
end

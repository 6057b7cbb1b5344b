defmodule Situ.Media.Recording.CodedImages do
  @moduledoc false
  # Returns the compressed images of a media file as they are in the file, so that a page decodes them by itself.
  # See docs/adr/0189-the-page-decodes-compressed-video.md.
  alias Situ.{Error, JSON}
  alias Situ.Media.FFmpeg
  alias Situ.Media.Recording.{CodecName, OpenFile, PacketPlaces}
  alias Situ.Recording.CodedVideo

  @seconds 30
  @entries "stream=codec_name,profile,pix_fmt,color_space,width,height,extradata:stream_side_data=rotation"
  # A request for more bytes is refused, unless it is for a single packet.
  @most_bytes 32 * 1_048_576

  @spec describe(OpenFile.t()) :: {:ok, CodedVideo.t()} | {:error, Error.t()}
  def describe(%OpenFile{index: %{places: nil}} = recording) do
    {:error,
     server_decodes(
       recording,
       "FFmpeg does not state where the images are in this kind of file, or two have the same time"
     )}
  end

  def describe(%OpenFile{} = recording) do
    with {:ok, stream} <- probe_stream(recording),
         {:ok, codec, setup} <- translate_codec(recording, stream),
         {:ok, rotation} <- parse_rotation(recording, stream["side_data_list"]),
         {:ok, [_]} <- read_packets(recording, 0, 1) do
      {:ok,
       %CodedVideo{
         codec: codec,
         description: setup,
         width: stream["width"] || 0,
         height: stream["height"] || 0,
         rotation: rotation,
         color: stated_color(stream["color_space"]),
         packets: pack_packets(recording)
       }}
    end
  end

  defp probe_stream(%{path: path, info: info} = recording) do
    args =
      ~w(-k 1 #{@seconds} ffprobe -hide_banner -loglevel quiet -of json -show_data) ++
        ~w(-select_streams #{info.video.index} -show_entries #{@entries}) ++
        FFmpeg.local_file(path)

    with {out, 0} <- System.cmd("timeout", args, env: []),
         {:ok, %{"streams" => [%{} = stream | _]}} <- JSON.decode(out) do
      {:ok, stream}
    else
      _ -> {:error, server_decodes(recording, "FFmpeg does not describe its codec")}
    end
  end

  defp translate_codec(recording, stream) do
    codec = text(stream["codec_name"])
    setup = CodecName.parse_dump(text(stream["extradata"]))

    case CodecName.translate(codec, setup, text(stream["profile"]), text(stream["pix_fmt"])) do
      {:ok, name, setup} -> {:ok, name, setup}
      :error -> {:error, server_decodes(recording, "no browser decodes #{codec}")}
    end
  end

  defp stated_color(color) when color in [nil, "unknown", "reserved"], do: nil
  defp stated_color(color), do: text(color)

  defp text(value), do: if(is_binary(value), do: value, else: "")

  # FFmpeg states the rotation counterclockwise.
  defp parse_rotation(recording, [_ | _] = list) do
    case Enum.find_value(list, &(is_map(&1) && &1["rotation"])) do
      nil ->
        {:ok, 0}

      angle when is_integer(angle) and rem(angle, 90) == 0 ->
        {:ok, Integer.mod(-angle, 360)}

      _ ->
        {:error, server_decodes(recording, "its images are turned by an angle other than 90°")}
    end
  end

  defp parse_rotation(_recording, _none), do: {:ok, 0}

  defp pack_packets(%{start: start, index: index}) do
    for {time, key?, size} <- PacketPlaces.list_rows(index.places), into: <<>> do
      time = if time, do: start + time, else: CodedVideo.hidden()
      <<time::signed-64, size::32, if(key?, do: 1, else: 0)::8>>
    end
  end

  @spec read_packets(OpenFile.t(), non_neg_integer(), non_neg_integer()) ::
          {:ok, [binary()]} | {:error, Error.t()}
  def read_packets(%OpenFile{index: %{places: places}} = recording, first, count) do
    with :ok <- check_span(recording, first, count),
         :ok <- OpenFile.check_unchanged(recording),
         {:ok, file} <- open_file(recording.path) do
      try do
        read_open_file(recording, file, {places, first, count})
      after
        :ok = :file.close(file)
      end
    end
  end

  defp read_open_file(recording, file, {places, first, count}) do
    case PacketPlaces.read(file, places, first, count) do
      {:ok, packets} -> {:ok, packets}
      :mismatch -> {:error, mismatch_error(recording)}
    end
  end

  defp check_span(%{index: %{places: places}} = recording, first, count) do
    sizes =
      if is_binary(places),
        do: PacketPlaces.list_sizes(places, first, count),
        else: []

    cond do
      length(sizes) != count -> {:error, no_packets_error(recording, first, count)}
      count > 1 and Enum.sum(sizes) > @most_bytes -> {:error, too_many_error()}
      true -> :ok
    end
  end

  defp open_file(path) do
    case :file.open(path, [:raw, :binary, :read]) do
      {:ok, file} -> {:ok, file}
      {:error, reason} -> {:error, Error.new(:no_file, "cannot read #{path}: #{reason}")}
    end
  end

  defp server_decodes(%{info: info}, why) do
    Error.new(:not_coded, "the images of #{info.name} can be decoded only on the server",
      why: why,
      fix: "convert the file: ffmpeg -i #{info.name} -c:v libx264 -g 60 converted.mp4"
    )
  end

  defp mismatch_error(%{info: info}) do
    Error.new(:damaged_media, "the packets of #{info.name} are not where its index states",
      why: "their checksums differ from the checksums of the packets that FFmpeg reads",
      fix: "copy the packets to a new file: ffmpeg -i #{info.name} -c copy repaired.mkv"
    )
  end

  defp no_packets_error(%{info: info}, first, count),
    do:
      Error.new(
        :bad_option,
        "#{info.name} does not have the packets #{first}..#{first + count - 1}"
      )

  defp too_many_error do
    Error.new(:bad_option, "the requested packets have more than 32 MB",
      fix: "request fewer packets"
    )
  end
end

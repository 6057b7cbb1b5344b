defmodule Situ.Media.SmallCopy do
  @moduledoc false
  # Writes the images of a video file into a store: small, at most ten per second, each a key frame, and with the times
  # that the images have in the file.
  alias Situ.{Error, Message, VideoPacket}
  alias Situ.Media.FFmpeg
  alias Situ.Media.FFmpeg.Reader
  alias Situ.Media.Recording.{Index, OpenFile}
  alias Situ.Media.StoredVideo.EncoderOptions
  alias Situ.Store.Writer

  @stream "Video"
  # The largest width and height of an image in pixels, and the least time between two images in seconds.
  @most_pixels 320
  @step_s 0.095
  @batch 64

  @doc "Writes the copy to a new folder."
  @spec write_copy(OpenFile.t(), Path.t()) :: :ok | {:error, Error.t()}
  def write_copy(%OpenFile{} = recording, folder) do
    with {:ok, {codec, encoder}} <- EncoderOptions.choose_encoder(:h264),
         {:ok, reader} <- start_reader(recording, encoder),
         {:ok, writer} <- Writer.create("copy", folder, versioned: false, first_extent: 65_536) do
      result = write_stream(recording, reader, writer, codec)
      Reader.stop_ffmpeg(reader)
      with :ok <- Writer.close(writer), do: result
    end
  end

  defp start_reader(%{path: path, info: info} = recording, encoder) do
    zero = if info.exact?, do: [], else: ["-start_at_zero"]

    filters =
      "select='isnan(prev_selected_t)+gte(t-prev_selected_t,#{@step_s})'," <>
        "scale=#{@most_pixels}:#{@most_pixels}:force_original_aspect_ratio=decrease:force_divisible_by=2," <>
        "format=yuv420p"

    # One thread leaves the other cores to the people who are working.
    args =
      ["-copyts" | zero] ++
        ~w(-threads 1 -max_pixels 67108864) ++
        FFmpeg.local_file(path) ++
        ["-map", "0:#{info.video.index}", "-vf", filters, "-threads", "1"] ++
        ~w(-fps_mode passthrough -enc_time_base:v #{FFmpeg.input_time_base()} -g 1) ++
        encoder_args(encoder)

    Reader.start_link(args: args, name: Path.basename(recording.path))
  end

  defp encoder_args("libx264"),
    do:
      ~w(-c:v libx264 -preset ultrafast -tune zerolatency -crf 26 -level 4.2 -bsf:v dump_extra=freq=keyframe)

  defp encoder_args("libopenh264"),
    do: ~w(-c:v libopenh264 -b:v 4M -bsf:v dump_extra=freq=keyframe)

  defp encoder_args(vpx), do: ~w(-c:v #{vpx} -deadline realtime -cpu-used 8 -b:v 4M)

  defp write_stream(recording, reader, writer, codec) do
    with {:ok, %{0 => %{width: width, height: height}}} <-
           Reader.fetch_streams(reader, :infinity),
         {:ok, stream} <- Writer.stream(writer, @stream, type: Situ.Image),
         fields = [codec: codec, position: 0, width: width, height: height, format: :bgr24],
         {:ok, stream, last} <- copy_packets(recording, reader, {stream, fields}, [], nil),
         {:ok, _} <- Writer.close_stream(stream, last || recording.start),
         do: :ok
  end

  # A damaged file is copied up to the damage.
  defp copy_packets(recording, reader, {stream, fields} = target, batch, last) do
    case Reader.next_frame(reader, :infinity) do
      {:ok, frame} ->
        message = build_message(recording, fields, frame)

        cond do
          last != nil and message.originating_time <= last ->
            copy_packets(recording, reader, target, batch, last)

          length(batch) >= @batch ->
            with {:ok, stream} <- Writer.append(stream, Enum.reverse(batch)) do
              target = {stream, fields}
              copy_packets(recording, reader, target, [message], message.originating_time)
            end

          true ->
            copy_packets(recording, reader, target, [message | batch], message.originating_time)
        end

      _ended when last != nil ->
        with {:ok, stream} <- Writer.append(stream, Enum.reverse(batch)), do: {:ok, stream, last}

      :eof ->
        {:error, Error.new(:no_pictures, "the file has no images")}

      {:error, error} ->
        {:error, error}
    end
  end

  defp build_message(%{index: index, start: start}, fields, frame) do
    time = start + Index.image_time(index, Index.nearest_image(index, frame.time))
    packet = struct!(VideoPacket, [data: frame.data] ++ fields)
    %Message{data: packet, originating_time: time, creation_time: time, sequence_id: 0}
  end
end

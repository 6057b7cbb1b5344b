defmodule Situ.Media.StoredVideo.FileCopy do
  @moduledoc false
  # Writes the packets of a stream to a media file without decoding them.
  alias Situ.{Error, Store, VideoPacket}
  alias Situ.Media.FFmpeg.Writer
  alias Situ.Media.FileInfo
  alias Situ.Store.{Query, VideoCoder}

  @fourcc %{h264: "H264", vp8: "VP80", vp9: "VP90"}
  @mp4 ~w(.mp4 .m4v .mov)
  @endings @mp4 ++ ~w(.mkv .webm)
  @batch 256
  # An MP4 player skips an image of duration 0, and no later image limits the last one. In seconds.
  @last_s 0.04

  @doc "Writes the file and returns the number of images."
  @spec write_file(Store.t(), String.t(), Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def write_file(store, name, path, opts) do
    with :ok <- check_ending(path),
         {:ok, info} <- Store.stream_info(store, name),
         :ok <- check_video(store, info),
         {:ok, ordinal} <- find_start(store, info, opts[:from]),
         {:ok, first} <- read_first(store, info, ordinal),
         {:ok, writer} <- start_writer(first, path) do
      job = %{
        store: store,
        info: info,
        writer: writer,
        start: first.originating_time,
        shape: shape_of(first.data),
        to: opts[:to] || :unbounded,
        progress: opts[:progress] || fn _count -> :ok end
      }

      finish_file(copy_packets(job, ordinal, 0), writer)
    end
  end

  defp check_ending(path) do
    if String.downcase(Path.extname(path)) in @endings,
      do: :ok,
      else:
        {:error,
         Error.new(:bad_option, "unknown file format: #{inspect(path)}",
           fix: "use one of the extensions #{Enum.join(@endings, " ")}"
         )}
  end

  defp check_video(store, info) do
    if VideoCoder.stored_as_video?(store, info),
      do: :ok,
      else:
        {:error,
         Error.new(:not_coded, "#{inspect(info.name)} is not stored as video",
           why: "only packets can be written to a video file without encoding",
           fix: "use the studio's video export, or Situ.Media.VideoWriter in a pipeline"
         )}
  end

  defp find_start(_store, _info, nil), do: {:ok, 0}

  defp find_start(store, info, from) do
    with {:ok, ordinal} <- Store.ordinal(store, info, from),
         do: {:ok, VideoCoder.find_key(store, info, ordinal)}
  end

  defp read_first(store, info, ordinal) do
    case Store.at(store, info, ordinal, packets: true) do
      {:ok, %{data: %VideoPacket{position: 0}} = message} ->
        {:ok, message}

      {:ok, _} ->
        {:error, Error.new(:no_pictures, "no key frame of #{inspect(info.name)} is there")}

      error ->
        error
    end
  end

  defp start_writer(%{data: packet, originating_time: start}, path) do
    stream = %{
      id: 0,
      class: :video,
      fourcc: @fourcc[packet.codec],
      width: packet.width + rem(packet.width, 2),
      height: packet.height + rem(packet.height, 2),
      setup: find_parameter_sets(packet)
    }

    args =
      ~w(-c:v copy -map_metadata -1 -metadata creation_time=#{Situ.Time.to_iso8601(start)}) ++
        ~w(-metadata #{FileInfo.start_tag()}=#{start}) ++
        format_args(String.downcase(Path.extname(path))) ++ ["file:" <> path]

    Writer.start_link(streams: [stream], args: args, name: Path.basename(path))
  end

  defp format_args(ending) when ending in @mp4,
    do:
      ~w(-movflags +use_metadata_tags+faststart -video_track_timescale 90000) ++
        ["-bsf:v", "setts=pts=PTS:dts=DTS:duration=#{@last_s}/TB"]

  defp format_args(_ending), do: ~w(-avoid_negative_ts disabled)

  # The units before the first image of a key frame.
  defp find_parameter_sets(%{codec: :h264, data: data}) do
    case Regex.run(~r/\x00?\x00\x00\x01[\x05\x25\x45\x65\x06]/s, data, return: :index) do
      [{at, _}] -> binary_part(data, 0, at)
      nil -> ""
    end
  end

  defp find_parameter_sets(_packet), do: ""

  defp shape_of(packet), do: {packet.codec, packet.width, packet.height}

  defp copy_packets(job, ordinal, count) do
    case Query.read_batch(job.store, job.info, ordinal, job.to, @batch, packets: true) do
      {:ok, [], _} ->
        {:ok, count}

      {:ok, messages, next} ->
        with :ok <- write_packets(job, messages) do
          job.progress.(count + length(messages))
          copy_packets(job, next, count + length(messages))
        end

      error ->
        error
    end
  end

  defp write_packets(job, messages) do
    Enum.reduce_while(messages, :ok, fn message, :ok ->
      case write_packet(job, message) do
        :ok -> {:cont, :ok}
        error -> {:halt, error}
      end
    end)
  end

  defp write_packet(job, %{data: %VideoPacket{} = packet, originating_time: time}) do
    if shape_of(packet) == job.shape,
      do:
        Writer.write_frame(
          job.writer,
          0,
          time - job.start,
          {packet.data, VideoPacket.key?(packet)}
        ),
      else: {:error, changed_error(job, time)}
  end

  defp write_packet(job, message), do: {:error, changed_error(job, message.originating_time)}

  defp changed_error(job, time) do
    Error.new(:bad_image, "the size of the images of #{inspect(job.info.name)} changes",
      why: "a video file has images of one size; that at #{Situ.Time.to_iso8601(time)} differs",
      fix: "write the parts to different files with --from and --to"
    )
  end

  defp finish_file({:ok, count}, writer) do
    with :ok <- Writer.finish_output(writer), do: {:ok, count}
  end

  defp finish_file(error, writer) do
    _ = Writer.finish_output(writer)
    error
  end
end

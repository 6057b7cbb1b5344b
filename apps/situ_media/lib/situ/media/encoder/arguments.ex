defmodule Situ.Media.Encoder.Arguments do
  @moduledoc false
  # Builds the output arguments for ffmpeg from the encoder's validated options. Pure.
  alias Situ.{Error, Media.FileInfo}

  @codecs [h264: "libx264", h265: "libx265", vp9: "libvpx-vp9", mpeg4: "mpeg4", mjpeg: "mjpeg"]
  @sounds [aac: "aac", opus: "libopus", mp3: "libmp3lame", flac: "flac", pcm: "pcm_s16le"]

  # {video codec, audio codec} of each extension. Matroska cannot represent the lead-in of AAC, so it uses FLAC.
  @mp4 [".mp4", ".m4v", ".mov", ".m4a"]
  @kinds %{
    ".mp4" => {:h264, :aac},
    ".m4v" => {:h264, :aac},
    ".mov" => {:h264, :aac},
    ".mkv" => {:h264, :flac},
    ".webm" => {:vp9, :opus},
    ".m4a" => {nil, :aac},
    ".mka" => {nil, :flac},
    ".flac" => {nil, :flac},
    ".ogg" => {nil, :opus},
    ".opus" => {nil, :opus},
    ".mp3" => {nil, :mp3}
  }

  @type kind :: %{ending: String.t(), video: atom() | nil, audio: atom()}

  @spec video_codecs() :: [atom()]
  def video_codecs, do: Keyword.keys(@codecs)

  @spec audio_codecs() :: [atom()]
  def audio_codecs, do: Keyword.keys(@sounds)

  @doc "Returns the file format for the extension, with its codecs."
  @spec resolve_kind(Path.t(), keyword()) :: {:ok, kind()} | {:error, Error.t()}
  def resolve_kind(path, opts) do
    ending = path |> Path.extname() |> String.downcase()

    case @kinds do
      %{^ending => {video, audio}} ->
        if opts[:video] && is_nil(video),
          do: {:error, sound_only(path)},
          else:
            {:ok,
             %{ending: ending, video: opts[:codec] || video, audio: opts[:audio_codec] || audio}}

      _ ->
        {:error,
         Error.new(:bad_option, "unknown file format: #{inspect(path)}",
           fix:
             "use one of the extensions " <>
               (@kinds |> Map.keys() |> Enum.sort() |> Enum.join(" "))
         )}
    end
  end

  defp sound_only(path),
    do:
      Error.new(:bad_option, "#{Path.basename(path)} cannot contain images", fix: "name it .mp4")

  @doc "Builds all arguments after the input: codecs, quality, tags and the file."
  @spec build_args(Path.t(), kind(), Situ.Image.t() | nil, keyword()) :: [String.t()]
  def build_args(path, kind, video, opts) do
    ~w(-threads #{opts[:threads]}) ++
      if(video, do: video_options(video, kind, opts), else: ["-vn"]) ++
      if(opts[:audio], do: audio_options(kind.audio, opts), else: ["-an"]) ++
      tag_args(kind, opts) ++ ["file:" <> path]
  end

  defp video_options(video, %{video: codec} = kind, opts) do
    rate =
      if opts[:bitrate], do: ~w(-b:v #{opts[:bitrate]}), else: quality_args(codec, opts[:quality])

    # Frames keep their own times, in ticks of a clock that is divisible by every common rate.
    ~w(-c:v #{@codecs[codec]} -fps_mode passthrough -enc_time_base 1:90000) ++
      last_frame(kind, opts) ++
      rate ++ preset_args(codec, opts[:preset]) ++ key_frames(opts) ++ pixel_args(video, codec)
  end

  # An MP4 player skips a frame of duration 0.
  defp last_frame(%{ending: ending}, opts) when ending in @mp4,
    do: ["-bsf:v", "setts=pts=PTS:dts=DTS:duration=#{opts[:last_frame] / 1.0e9}/TB"]

  defp last_frame(_kind, _opts), do: []

  defp quality_args(codec, quality) when codec in [:h264, :h265], do: ~w(-crf #{quality})
  defp quality_args(:vp9, quality), do: ~w(-crf #{quality} -b:v 0)
  # Other codecs use a separate scale from 1 (best) to 31.
  defp quality_args(_codec, quality), do: ~w(-q:v #{max(div(quality * 31, 51), 1)})

  defp preset_args(codec, preset) when codec in [:h264, :h265], do: ~w(-preset #{preset})
  defp preset_args(:vp9, _preset), do: ~w(-deadline realtime -cpu-used 6 -row-mt 1)
  defp preset_args(_codec, _preset), do: []

  defp key_frames(opts) do
    seconds = opts[:keyframe_every] / 1.0e9
    ["-force_key_frames", "expr:gte(t,n_forced*#{seconds})"]
  end

  # Half-resolution color, which every player supports, needs even sizes.
  defp pixel_args(%{width: w, height: h}, codec) do
    pad =
      if rem(w, 2) == 1 or rem(h, 2) == 1,
        do: ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"],
        else: []

    pad ++ ["-pix_fmt", if(codec == :mjpeg, do: "yuvj420p", else: "yuv420p")]
  end

  defp audio_options(codec, opts) do
    rate = if codec in [:aac, :opus, :mp3], do: ~w(-b:a #{opts[:audio_bitrate]}), else: []
    # Fills gaps in the audio with silence, so that it stays synchronized with the images.
    ~w(-c:a #{@sounds[codec]} -af aresample=async=1:min_hard_comp=0.04:first_pts=0) ++ rate
  end

  defp tag_args(kind, opts) do
    start = opts[:start_time]

    flags =
      cond do
        kind.ending not in @mp4 -> ~w(-avoid_negative_ts disabled)
        opts[:fragmented] -> ~w(-movflags +use_metadata_tags+frag_keyframe+delay_moov)
        true -> ~w(-movflags +use_metadata_tags+faststart -video_track_timescale 90000)
      end

    ~w(-map_metadata -1 -metadata creation_time=#{Situ.Time.to_iso8601(start)}) ++
      ~w(-metadata #{FileInfo.start_tag()}=#{start}) ++ flags
  end
end

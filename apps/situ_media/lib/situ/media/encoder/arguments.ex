defmodule Situ.Media.Encoder.Arguments do
  @moduledoc false
  # The arguments for ffmpeg's output: pure, from the encoder's checked options.
  alias Situ.{Error, Media.FileInfo}

  @codecs [h264: "libx264", h265: "libx265", vp9: "libvpx-vp9", mpeg4: "mpeg4", mjpeg: "mjpeg"]
  @sounds [aac: "aac", opus: "libopus", mp3: "libmp3lame", flac: "flac", pcm: "pcm_s16le"]

  # {video codec, sound codec} of each kind of file. Matroska cannot express the lead-in of AAC, so it gets FLAC.
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

  @spec codecs() :: [atom()]
  def codecs, do: Keyword.keys(@codecs)

  @spec sounds() :: [atom()]
  def sounds, do: Keyword.keys(@sounds)

  @doc "The kind of file that a name asks for, and its codecs."
  @spec kind(Path.t(), keyword()) :: {:ok, kind()} | {:error, Error.t()}
  def kind(path, opts) do
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
         Error.new(:bad_option, "cannot tell what kind of file #{inspect(path)} should be",
           fix:
             "end its name in one of " <> (@kinds |> Map.keys() |> Enum.sort() |> Enum.join(" "))
         )}
    end
  end

  defp sound_only(path),
    do: Error.new(:bad_option, "#{Path.basename(path)} cannot hold pictures", fix: "name it .mp4")

  @doc "Everything after the input: codecs, quality, tags and the file."
  @spec build(Path.t(), kind(), Situ.Image.t() | nil, keyword()) :: [String.t()]
  def build(path, kind, video, opts) do
    ~w(-threads #{opts[:threads]}) ++
      if(video, do: video_options(video, kind, opts), else: ["-vn"]) ++
      if(opts[:audio], do: audio_options(kind.audio, opts), else: ["-an"]) ++
      tags(kind, opts) ++ ["file:" <> path]
  end

  defp video_options(video, %{video: codec} = kind, opts) do
    rate = if opts[:bitrate], do: ~w(-b:v #{opts[:bitrate]}), else: quality(codec, opts[:quality])
    # Frames keep their own times, in ticks of a clock that divides every usual rate.
    ~w(-c:v #{@codecs[codec]} -fps_mode passthrough -enc_time_base 1:90000) ++
      last_frame(kind, opts) ++
      rate ++ effort(codec, opts[:preset]) ++ key_frames(opts) ++ pixels(video, codec)
  end

  # An MP4 player leaves a frame out that lasts no time.
  defp last_frame(%{ending: ending}, opts) when ending in @mp4,
    do: ["-bsf:v", "setts=pts=PTS:dts=DTS:duration=#{opts[:last_frame] / 1.0e9}/TB"]

  defp last_frame(_kind, _opts), do: []

  defp quality(codec, quality) when codec in [:h264, :h265], do: ~w(-crf #{quality})
  defp quality(:vp9, quality), do: ~w(-crf #{quality} -b:v 0)
  # A scale of its own, 1 (best) to 31.
  defp quality(_codec, quality), do: ~w(-q:v #{max(div(quality * 31, 51), 1)})

  defp effort(codec, preset) when codec in [:h264, :h265], do: ~w(-preset #{preset})
  defp effort(:vp9, _preset), do: ~w(-deadline realtime -cpu-used 6 -row-mt 1)
  defp effort(_codec, _preset), do: []

  defp key_frames(opts) do
    seconds = opts[:keyframe_every] / 1.0e9
    ["-force_key_frames", "expr:gte(t,n_forced*#{seconds})"]
  end

  # Half-resolution colour, which every player knows, needs even sizes.
  defp pixels(%{width: w, height: h}, codec) do
    pad =
      if rem(w, 2) == 1 or rem(h, 2) == 1,
        do: ["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"],
        else: []

    pad ++ ["-pix_fmt", if(codec == :mjpeg, do: "yuvj420p", else: "yuv420p")]
  end

  defp audio_options(codec, opts) do
    rate = if codec in [:aac, :opus, :mp3], do: ~w(-b:a #{opts[:audio_bitrate]}), else: []
    # Gaps in the sound are filled with silence, so that it stays in step with the pictures.
    ~w(-c:a #{@sounds[codec]} -af aresample=async=1:min_hard_comp=0.04:first_pts=0) ++ rate
  end

  defp tags(kind, opts) do
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

defmodule Situ.Media.StoredVideo.EncoderOptions do
  @moduledoc false
  # The options of compressed images in recordings, and their translation to the arguments of ffmpeg.
  alias Situ.{Error, Image}
  alias Situ.Media.FFmpeg

  @schema [
    quality: [
      type: {:integer, 0, 51},
      default: 23,
      doc:
        "Constant quality; lower values mean better quality and larger recordings (x264's CRF)."
    ],
    bitrate: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Bits per second, instead of a constant quality."
    ],
    keyframe_every: [
      type: :pos_integer,
      default: 2_000_000_000,
      doc:
        "Time between key frames, ns. A jump to a time decodes from the key frame before it, so a smaller value " <>
          "makes jumps faster and the recording larger."
    ],
    preset: [
      type: {:in, [:ultrafast, :veryfast, :fast, :medium, :slow]},
      default: :veryfast,
      doc: "Trade-off of speed and size (H.264)."
    ],
    threads: [type: :non_neg_integer, default: 0, doc: "Encoder threads; 0: one per core."]
  ]

  # {codec, encoder of FFmpeg}, in the order of preference. A codec that no installed encoder makes is replaced by the
  # next of the list.
  @encoders [h264: "libx264", h264: "libopenh264", vp8: "libvpx", vp9: "libvpx-vp9"]
  @codecs @encoders |> Keyword.keys() |> Enum.uniq()
  @formats [:gray8, :bgr24, :rgb24]

  @doc "Returns the schema of the options."
  @spec schema() :: Situ.Options.schema()
  def schema, do: @schema

  @doc "Parses the value of `encode:`, `codec` or `{codec, options}`."
  @spec parse(term()) :: {:ok, {Situ.VideoPacket.codec(), keyword()}} | {:error, Error.t()}
  def parse(codec) when codec in @codecs, do: parse({codec, []})

  def parse({codec, opts}) when codec in @codecs and is_list(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema), do: {:ok, {codec, opts}}
  end

  def parse(other) do
    {:error,
     Error.new(:bad_option, "encode: #{inspect(other, limit: 5)} is not a video codec",
       why: "the codecs are #{Enum.map_join(@codecs, ", ", &inspect/1)}",
       fix: "write encode: :h264, or encode: {:h264, quality: 28}"
     )}
  end

  @doc """
  Chooses the encoder for a codec from the names of installed ones.

      iex> alias Situ.Media.StoredVideo.EncoderOptions
      iex> EncoderOptions.choose_encoder(:h264, ["libopenh264", "libvpx"])
      {:ok, {:h264, "libopenh264"}}
      iex> EncoderOptions.choose_encoder(:h264, ["libvpx"])
      {:ok, {:vp8, "libvpx"}}
      iex> {:error, error} = EncoderOptions.choose_encoder(:vp9, ["mpeg4"])
      iex> error.code
      :no_encoder
  """
  @spec choose_encoder(Situ.VideoPacket.codec(), [String.t()]) ::
          {:ok, {Situ.VideoPacket.codec(), String.t()}} | {:error, Error.t()}
  def choose_encoder(codec, installed \\ installed_encoders()) do
    {wanted, others} = Enum.split_with(@encoders, fn {name, _} -> name == codec end)

    case Enum.find(wanted ++ others, fn {_, encoder} -> encoder in installed end) do
      nil -> {:error, no_encoder_error(codec)}
      found -> {:ok, found}
    end
  end

  defp no_encoder_error(codec) do
    names = @encoders |> Keyword.values() |> Enum.join(", ")

    Error.new(:no_encoder, "images cannot be compressed as #{inspect(codec)}",
      why: "the installed FFmpeg has none of the encoders #{names}",
      fix: "install an FFmpeg with libx264: apt-get install ffmpeg; or record without encode:"
    )
  end

  # The list does not change while the VM is running.
  defp installed_encoders do
    key = {__MODULE__, System.find_executable("ffmpeg")}

    with nil <- :persistent_term.get(key, nil),
         {:ok, program} <- FFmpeg.fetch_executable("ffmpeg") do
      {text, _} = System.cmd(program, ~w(-hide_banner -encoders), stderr_to_stdout: true)
      names = for [_, name] <- Regex.scan(~r/^ V\S{5} (\S+)/m, text), do: name
      :persistent_term.put(key, names)
      names
    else
      names when is_list(names) -> names
      {:error, _} -> []
    end
  end

  @doc "Returns an error for an image that would lose more than a video loses."
  @spec check_image(Image.t()) :: :ok | {:error, Error.t()}
  def check_image(%Image{format: format}) when format in @formats, do: :ok

  def check_image(%Image{} = image) do
    {:error,
     Error.new(:bad_image, "#{Image.describe(image)} cannot be stored as video",
       why: "video has 8 bits per channel and no transparency",
       fix: "convert the images to :bgr24 or :gray8 first, or record them without encode:"
     )}
  end

  @doc "Returns the arguments that make packets of the images."
  @spec build_args(String.t(), Image.t(), keyword()) :: [String.t()]
  def build_args(encoder, image, opts) do
    seconds = opts[:keyframe_every] / 1.0e9

    ["-vf", filters(image), "-threads", "#{opts[:threads]}"] ++
      ~w(-c:v #{encoder} -fps_mode passthrough -enc_time_base #{FFmpeg.input_time_base()}) ++
      ["-force_key_frames", "expr:isnan(prev_forced_t)+gte(t,prev_forced_t+#{seconds})"] ++
      rate_args(encoder, opts) ++ codec_args(encoder, image, opts)
  end

  # Color has half the resolution, so sizes must be even. The row or column that is added repeats its neighbor.
  defp filters(%{width: w, height: h}) do
    {right, bottom} = {rem(w, 2), rem(h, 2)}
    size = "#{w + right}:#{h + bottom}"

    odd =
      if right + bottom > 0,
        do: ["pad=#{size}", "fillborders=right=#{right}:bottom=#{bottom}:mode=smear"],
        else: []

    Enum.join(odd ++ ["scale=#{size}:flags=#{scale_flags()}", "format=yuv420p"], ",")
  end

  @doc "Returns the flags of conversions between RGB and video, with which the same bytes always give the same pixels."
  @spec scale_flags() :: String.t()
  def scale_flags, do: "bicubic+accurate_rnd+full_chroma_int+full_chroma_inp+bitexact"

  defp rate_args("libopenh264", opts), do: bitrate_args(opts[:bitrate] || 8_000_000)

  defp rate_args(encoder, opts) do
    cond do
      opts[:bitrate] -> bitrate_args(opts[:bitrate])
      encoder == "libx264" -> ~w(-crf #{opts[:quality]})
      # Its scale begins at 4, and without a limit the bit rate is only 256 kbit/s.
      encoder == "libvpx" -> ~w(-crf #{max(opts[:quality], 4)} -b:v 50M)
      true -> ~w(-crf #{opts[:quality]} -b:v 0)
    end
  end

  defp bitrate_args(rate), do: ~w(-b:v #{rate})

  # A packet must not wait for later images. The parameters of H.264 are repeated in every key frame, so that a decoder
  # can start at each.
  defp codec_args("libx264", image, opts) do
    ~w(-preset #{opts[:preset]} -tune zerolatency -g 100000 -level #{h264_level(image)}) ++
      ~w(-bsf:v dump_extra=freq=keyframe)
  end

  defp codec_args("libopenh264", _image, _opts), do: ~w(-g 100000 -bsf:v dump_extra=freq=keyframe)

  defp codec_args(_vpx, _image, _opts),
    do: ~w(-deadline realtime -cpu-used 6 -lag-in-frames 0 -auto-alt-ref 0 -g 100000)

  # The rate of the images is not known in advance. These levels allow 60 images per second of 1920x1080 and 4096x2160.
  defp h264_level(%{width: w, height: h}) when w * h <= 2_088_960, do: "4.2"
  defp h264_level(%{width: w, height: h}) when w * h <= 8_912_896, do: "5.2"
  defp h264_level(_image), do: "6.2"
end

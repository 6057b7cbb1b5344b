defmodule Situ.Media.Encoder do
  @moduledoc """
  Writes a video file with audio, without a pipeline. The extension of the file sets its format: `.mp4`, `.m4v`, `.mov`,
  `.mkv`, `.webm`, and for audio only `.m4a`, `.mka`, `.flac`, `.ogg`, `.opus`, `.mp3`. (AVI is not supported because it
  stores no times.)

      {:ok, encoder} = Situ.Media.Encoder.open("out.mp4", video: image, audio: format, start_time: t0)
      :ok = Situ.Media.Encoder.video(encoder, t0, image)
      :ok = Situ.Media.Encoder.audio(encoder, t0 + Situ.Time.ms(20), buffer)
      :ok = Situ.Media.Encoder.close(encoder)

  Times are originating times: an image has the time it was taken, and an audio buffer the time it ended. `start_time`
  is the file's time 0. It is stored in the file to the nanosecond (`Situ.Media.FileInfo`), so that reading the file
  gives the same originating times. Frame times are kept (variable frame rate), rounded to 1/90,000 s.
  """
  alias Situ.{AudioBuffer, AudioFormat, Error, Image}
  alias Situ.Media.Encoder.Arguments
  alias Situ.Media.FFmpeg.FormatNames
  alias Situ.Media.FFmpeg.Writer

  @schema [
    codec: [
      type: {:optional, {:in, Arguments.video_codecs()}},
      default: nil,
      doc: "Video codec; `nil`: `:vp9` for .webm, else `:h264`."
    ],
    audio_codec: [
      type: {:optional, {:in, Arguments.audio_codecs()}},
      default: nil,
      doc: "Audio codec; `nil`: the default of the file's format."
    ],
    quality: [
      type: {:integer, 0, 51},
      default: 23,
      doc: "Constant quality; lower values mean better quality and larger files (x264's CRF)."
    ],
    bitrate: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Video bits per second, instead of a constant quality."
    ],
    audio_bitrate: [type: :pos_integer, default: 128_000, doc: "Audio bits per second."],
    preset: [
      type: {:in, [:ultrafast, :veryfast, :fast, :medium, :slow]},
      default: :veryfast,
      doc: "Trade-off of speed and file size (H.264, H.265)."
    ],
    keyframe_every: [
      type: :pos_integer,
      default: 2_000_000_000,
      doc: "Maximum time between key frames, ns; limits how precisely a player can seek."
    ],
    fragmented: [
      type: :boolean,
      default: false,
      doc: "Write MP4 in fragments, so that it is readable up to the last one after a crash."
    ],
    last_frame: [
      type: :pos_integer,
      default: 40_000_000,
      doc: "Display time of the last image, ns, since no later image limits it."
    ],
    threads: [type: :non_neg_integer, default: 0, doc: "Encoder threads; 0: one per core."]
  ]

  @inputs [
    video: [
      type: {:optional, {:struct, Image}},
      default: nil,
      doc: "An image of the size and format of all images."
    ],
    audio: [type: {:optional, {:struct, AudioFormat}}, default: nil, doc: "The audio format."],
    start_time: [type: :time_ns, required: true, doc: "Originating time that becomes 0."]
  ]

  @enforce_keys [:writer, :path, :start_time]
  defstruct [:writer, :path, :start_time, :video, :audio, :audio_id]

  @type t :: %__MODULE__{}

  @doc "Returns the schema of the codec and quality options."
  @spec option_schema() :: Situ.Options.schema()
  def option_schema, do: @schema

  @doc """
  Creates the file and replaces an existing one. `video:`, `audio:` or both are required.

  #{Situ.Options.docs(@inputs ++ @schema)}
  """
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @inputs ++ @schema),
         :ok <- check_inputs(opts),
         {:ok, kind} <- Arguments.resolve_kind(path, opts),
         :ok <- check_folder(path) do
      video = opts[:video] && %{opts[:video] | data: <<>>}
      audio_id = if video, do: 1, else: 0
      streams = video_stream(video) ++ audio_stream(opts[:audio], audio_id)

      with {:ok, writer} <-
             Writer.start_link(
               streams: streams,
               args: Arguments.build_args(path, kind, video, opts),
               name: Path.basename(path)
             ) do
        {:ok,
         %__MODULE__{
           writer: writer,
           path: path,
           start_time: opts[:start_time],
           video: video,
           audio: opts[:audio],
           audio_id: audio_id
         }}
      end
    end
  end

  @doc "Writes an image taken at `time`."
  @spec video(t(), Situ.Time.t(), Image.t()) :: :ok | {:error, Error.t()}
  def video(%__MODULE__{video: video} = encoder, time, %Image{} = image) do
    with :ok <- check_time(encoder, time),
         :ok <- same_picture(encoder, video, image),
         {:ok, image} <- Image.validate(image) do
      Writer.write_frame(encoder.writer, 0, time - encoder.start_time, Image.pixel_bytes(image))
    end
  end

  @doc "Writes an audio buffer that ended at `time`."
  @spec audio(t(), Situ.Time.t(), AudioBuffer.t()) :: :ok | {:error, Error.t()}
  def audio(%__MODULE__{audio: format} = encoder, time, %AudioBuffer{format: format} = buffer) do
    start = AudioBuffer.start_time(buffer, time)

    with {:ok, buffer} <- AudioBuffer.validate(buffer),
         :ok <- check_time(encoder, start) do
      Writer.write_frame(
        encoder.writer,
        encoder.audio_id,
        start - encoder.start_time,
        buffer.data
      )
    end
  end

  def audio(%__MODULE__{} = encoder, _time, %AudioBuffer{} = buffer) do
    {:error,
     Error.new(
       :bad_audio,
       "#{Path.basename(encoder.path)} contains #{describe_audio(encoder.audio)}",
       why: "the audio format is fixed when the file is opened; got #{inspect(buffer)}",
       fix: "resample the stream before writing it"
     )}
  end

  @doc "Waits for the encoder and finishes the file."
  @spec close(t()) :: :ok | {:error, Error.t()}
  def close(%__MODULE__{writer: writer}), do: Writer.finish_output(writer)

  defp check_inputs(opts) do
    if opts[:video] || opts[:audio],
      do: :ok,
      else:
        {:error, Error.new(:bad_option, "a media file needs images (video:) or audio (audio:)")}
  end

  defp check_folder(path) do
    folder = Path.dirname(path)

    if File.dir?(folder),
      do: :ok,
      else: {:error, Error.new(:cannot_write, "the folder #{inspect(folder)} does not exist")}
  end

  defp check_time(encoder, time) do
    if time >= encoder.start_time,
      do: :ok,
      else:
        {:error,
         Error.new(:before_start, "data is too early for #{Path.basename(encoder.path)}",
           why: "it is #{encoder.start_time - time} ns before the file's time 0"
         )}
  end

  defp same_picture(_encoder, %{width: w, height: h, format: f}, %{width: w, height: h, format: f}),
       do: :ok

  defp same_picture(encoder, expected, image) do
    {:error,
     Error.new(:bad_image, "#{Path.basename(encoder.path)} contains #{describe_video(expected)}",
       why:
         "all images of a video must have the same size and format; this one is #{describe_video(image)}",
       fix: "resize and convert the stream before writing it"
     )}
  end

  defp describe_audio(nil), do: "no audio"
  defp describe_audio(format), do: inspect(format)
  defp describe_video(nil), do: "no images"
  defp describe_video(image), do: Image.describe(image)

  defp video_stream(nil), do: []

  defp video_stream(image) do
    fourcc = FormatNames.fourcc(image.format)
    [%{id: 0, class: :video, fourcc: fourcc, width: image.width, height: image.height}]
  end

  defp audio_stream(nil, _id), do: []

  defp audio_stream(format, id) do
    fourcc = FormatNames.fourcc(format.sample)
    [%{id: id, class: :audio, fourcc: fourcc, rate: format.rate, channels: format.channels}]
  end
end

defmodule Situ.Media.Encoder do
  @moduledoc """
  Writes a video file with sound, without a pipeline. The file's name decides its kind: `.mp4`, `.m4v`, `.mov`, `.mkv`,
  `.webm`, and for sound alone `.m4a`, `.mka`, `.flac`, `.ogg`, `.opus`, `.mp3`. (AVI is not written: it keeps no
  times.)

      {:ok, encoder} = Situ.Media.Encoder.open("out.mp4", video: image, audio: format, start_time: t0)
      :ok = Situ.Media.Encoder.video(encoder, t0, image)
      :ok = Situ.Media.Encoder.audio(encoder, t0 + Situ.Time.ms(20), buffer)
      :ok = Situ.Media.Encoder.close(encoder)

  Times are originating times: of a picture when it was taken, of a piece of sound when it ended. `start_time` is the
  file's time 0, and is kept in the file to the nanosecond (`Situ.Media.FileInfo`), so that reading it back gives the
  same originating times. Frame times are kept as they are (variable frame rate), to a 90,000th of a second.
  """
  alias Situ.{AudioBuffer, AudioFormat, Error, Image}
  alias Situ.Media.Encoder.Arguments
  alias Situ.Media.Pixels
  alias Situ.Media.FFmpeg.Writer

  @schema [
    codec: [
      type: {:optional, {:in, Arguments.codecs()}},
      default: nil,
      doc: "Video codec; `nil`: `:vp9` for .webm, else `:h264`."
    ],
    audio_codec: [
      type: {:optional, {:in, Arguments.sounds()}},
      default: nil,
      doc: "Sound codec; `nil`: what suits the kind of file."
    ],
    quality: [
      type: {:integer, 0, 51},
      default: 23,
      doc: "Constant quality, lower is better and larger (x264's CRF)."
    ],
    bitrate: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Bits a second for the pictures, instead of a constant quality."
    ],
    audio_bitrate: [type: :pos_integer, default: 128_000, doc: "Bits a second for the sound."],
    preset: [
      type: {:in, [:ultrafast, :veryfast, :fast, :medium, :slow]},
      default: :veryfast,
      doc: "Speed against size (H.264, H.265)."
    ],
    keyframe_every: [
      type: :pos_integer,
      default: 2_000_000_000,
      doc: "Longest time between key frames, ns: how finely a player can seek."
    ],
    fragmented: [
      type: :boolean,
      default: false,
      doc:
        "MP4 that can be read up to the last fragment even when the machine died while writing."
    ],
    last_frame: [
      type: :pos_integer,
      default: 40_000_000,
      doc: "How long the last picture is shown, ns: nothing after it tells."
    ],
    threads: [type: :non_neg_integer, default: 0, doc: "Encoder threads; 0: as many as cores."]
  ]

  @inputs [
    video: [
      type: {:optional, {:struct, Image}},
      default: nil,
      doc: "A picture of the size and format all will have."
    ],
    audio: [type: {:optional, {:struct, AudioFormat}}, default: nil, doc: "The sound's format."],
    start_time: [type: :time_ns, required: true, doc: "Originating time that becomes 0."]
  ]

  @enforce_keys [:writer, :path, :start_time]
  defstruct [:writer, :path, :start_time, :video, :audio, :audio_id]

  @type t :: %__MODULE__{}

  @doc "The options about codecs and quality."
  @spec options() :: Situ.Options.schema()
  def options, do: @schema

  @doc """
  Creates the file (an existing one is replaced). At least one of `video:` and `audio:` is needed.

  #{Situ.Options.docs(@inputs ++ @schema)}
  """
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(path, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @inputs ++ @schema),
         :ok <- check_inputs(opts),
         {:ok, kind} <- Arguments.kind(path, opts),
         :ok <- check_folder(path) do
      video = opts[:video] && %{opts[:video] | data: <<>>}
      audio_id = if video, do: 1, else: 0
      streams = video_stream(video) ++ audio_stream(opts[:audio], audio_id)

      with {:ok, writer} <-
             Writer.start_link(
               streams: streams,
               args: Arguments.build(path, kind, video, opts),
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

  @doc "Writes a picture taken at `time`."
  @spec video(t(), Situ.Time.t(), Image.t()) :: :ok | {:error, Error.t()}
  def video(%__MODULE__{video: video} = encoder, time, %Image{} = image) do
    with :ok <- check_time(encoder, time),
         :ok <- same_picture(encoder, video, image),
         {:ok, image} <- Image.validate(image) do
      Writer.write(encoder.writer, 0, time - encoder.start_time, Image.pixels(image))
    end
  end

  @doc "Writes a piece of sound that ended at `time`."
  @spec audio(t(), Situ.Time.t(), AudioBuffer.t()) :: :ok | {:error, Error.t()}
  def audio(%__MODULE__{audio: format} = encoder, time, %AudioBuffer{format: format} = buffer) do
    start = AudioBuffer.start_time(buffer, time)

    with {:ok, buffer} <- AudioBuffer.validate(buffer),
         :ok <- check_time(encoder, start) do
      Writer.write(encoder.writer, encoder.audio_id, start - encoder.start_time, buffer.data)
    end
  end

  def audio(%__MODULE__{} = encoder, _time, %AudioBuffer{} = buffer) do
    {:error,
     Error.new(:bad_audio, "#{Path.basename(encoder.path)} holds #{sound(encoder.audio)}",
       why: "the format of the sound is fixed when the file is opened; got #{inspect(buffer)}",
       fix: "resample the stream before writing it"
     )}
  end

  @doc "Finishes the file; waits for the encoder."
  @spec close(t()) :: :ok | {:error, Error.t()}
  def close(%__MODULE__{writer: writer}), do: Writer.finish(writer)

  defp check_inputs(opts) do
    if opts[:video] || opts[:audio],
      do: :ok,
      else:
        {:error, Error.new(:bad_option, "a media file needs pictures (video:) or sound (audio:)")}
  end

  defp check_folder(path) do
    folder = Path.dirname(path)

    if File.dir?(folder),
      do: :ok,
      else: {:error, Error.new(:cannot_write, "there is no folder #{inspect(folder)}")}
  end

  defp check_time(encoder, time) do
    if time >= encoder.start_time,
      do: :ok,
      else:
        {:error,
         Error.new(:before_start, "#{Path.basename(encoder.path)} has begun already",
           why: "the data is #{encoder.start_time - time} ns older than the file's time 0"
         )}
  end

  defp same_picture(_encoder, %{width: w, height: h, format: f}, %{width: w, height: h, format: f}),
       do: :ok

  defp same_picture(encoder, expected, image) do
    {:error,
     Error.new(:bad_image, "#{Path.basename(encoder.path)} holds #{describe(expected)}",
       why:
         "every picture of a video has the same size and format; this one is #{describe(image)}",
       fix: "resize and convert the stream before writing it"
     )}
  end

  defp sound(nil), do: "no sound"
  defp sound(format), do: inspect(format)
  defp describe(nil), do: "no pictures"
  defp describe(image), do: Image.describe(image)

  defp video_stream(nil), do: []

  defp video_stream(image) do
    fourcc = Pixels.fourcc(image.format)
    [%{id: 0, class: :video, fourcc: fourcc, width: image.width, height: image.height}]
  end

  defp audio_stream(nil, _id), do: []

  defp audio_stream(format, id) do
    fourcc = Pixels.fourcc(format.sample)
    [%{id: id, class: :audio, fourcc: fourcc, rate: format.rate, channels: format.channels}]
  end
end

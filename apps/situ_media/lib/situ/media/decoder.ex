defmodule Situ.Media.Decoder do
  @moduledoc """
  Reads a media file as pictures and sound in the order of time, without a pipeline.

      {:ok, decoder} = Situ.Media.Decoder.open("talk1.mp4", start: Situ.Time.s(2))
      {:video, 2_000_000_000, %Situ.Image{}, decoder} = Situ.Media.Decoder.next(decoder)
      :ok = Situ.Media.Decoder.close(decoder)

  Times are media time in nanoseconds, exact from the file's own time base, 0 at the start of the file. The time of a
  picture is when it is shown; the time of a piece of sound is when it **ends**. Each kind's times strictly increase:
  a picture that claims a time at or before the one before it is left out and counted in `dropped`.

  `Situ.Media.VideoFile` is the source for pipelines.
  """
  alias Situ.{AudioBuffer, AudioFormat, Error, Image}
  alias Situ.Media.{FFmpeg, FileInfo, Nut, Pixels}
  alias Situ.Media.FFmpeg.Reader

  @schema [
    start: [
      type: {:integer, 0, 1_000_000_000_000_000},
      default: 0,
      doc: "Media time to begin at, ns: the first picture at or after it."
    ],
    end: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Media time to end before, ns; `nil`: the whole file."
    ],
    video: [type: :boolean, default: true, doc: "Read the pictures."],
    audio: [type: :boolean, default: true, doc: "Read the sound."],
    format: [
      type: {:in, Image.Format.all()},
      default: :bgr24,
      doc: "Pixel format of the pictures."
    ],
    size: [
      type: {:optional, {:tuple, [:pos_integer, :pos_integer]}},
      default: nil,
      doc: "`{width, height}` to scale to while decoding; `nil`: as recorded."
    ],
    audio_format: [
      type: {:optional, {:struct, AudioFormat}},
      default: nil,
      doc: "Convert the sound to this; `nil`: 16-bit samples at the file's rate and channels."
    ],
    audio_buffer: [
      type: :pos_integer,
      default: 20_000_000,
      doc: "Length of one piece of sound, ns; the last may be shorter."
    ],
    max_pixels: [
      type: :pos_integer,
      default: 67_108_864,
      doc: "Refuse pictures with more pixels, whatever the file claims."
    ],
    threads: [
      type: :non_neg_integer,
      default: 0,
      doc: "Decoder threads; 0: as many as cores."
    ],
    loop: [type: :boolean, default: false, doc: "Begin again at the end, times running on."]
  ]

  @enforce_keys [:reader, :info]
  defstruct [
    :reader,
    :info,
    :video,
    :audio,
    :format,
    :audio_format,
    :audio_end,
    :video_end,
    :loop,
    :streams,
    last: %{},
    dropped: 0
  ]

  @type t :: %__MODULE__{}
  @type item ::
          {:video, Situ.Time.t(), Image.t(), t()}
          | {:audio, Situ.Time.t(), AudioBuffer.t(), t()}
          | {:eof, t()}
          | {:error, Error.t(), t()}

  @doc "The options of `open/2`."
  @spec options() :: Situ.Options.schema()
  def options, do: @schema

  @doc """
  Starts decoding the file at `path`; the caller's process owns the decoder.

  #{Situ.Options.docs(@schema)}
  """
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(path, opts \\ []) do
    with {:ok, info} <- FileInfo.read(path), do: open(path, info, opts)
  end

  @doc "As `open/2` for a file that was looked into before."
  @spec open(Path.t(), FileInfo.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(path, %FileInfo{} = info, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, opts} <- check_span(opts, info),
         video = if(opts[:video], do: info.video),
         audio = if(opts[:audio], do: info.audio),
         :ok <- check_any(video, audio, info),
         audio_format = audio && audio_format(audio, opts[:audio_format]),
         args = input(path, info, opts) ++ output(video, audio, audio_format, opts),
         {:ok, reader} <- Reader.start_link(args: args, name: info.name) do
      {:ok,
       %__MODULE__{
         reader: reader,
         info: info,
         video: video && 0,
         audio: audio && if(video, do: 1, else: 0),
         format: opts[:format],
         audio_format: audio_format,
         video_end: opts[:end],
         audio_end: audio && least(audio_end(info, audio), opts[:end]),
         loop: opts[:loop]
       }}
    end
  end

  @doc "The next picture or piece of sound; waits for it."
  @spec next(t()) :: item()
  def next(%__MODULE__{} = decoder) do
    case Reader.next(decoder.reader, :infinity) do
      {:ok, frame} -> deliver(frame, decoder)
      :eof -> {:eof, decoder}
      {:error, error} -> {:error, error, decoder}
    end
  end

  @doc "Ends the decoder at once."
  @spec close(t()) :: :ok
  def close(%__MODULE__{reader: reader}), do: Reader.stop(reader)

  @doc false
  # A frame of the reader as a picture or sound; shared with live sources.
  @spec convert(Nut.Demuxer.frame(), Nut.stream(), Image.Format.t() | nil, AudioFormat.t() | nil) ::
          {:video, Situ.Time.t(), Image.t()} | {:audio, Situ.Time.t(), AudioBuffer.t()}
  def convert(frame, %{class: :video} = stream, format, _audio_format) do
    image = %Image{
      width: stream.width,
      height: stream.height,
      format: format,
      stride: stream.width * Image.Format.bytes_per_pixel(format),
      data: frame.data
    }

    {:video, frame.time, image}
  end

  def convert(frame, %{class: :audio} = stream, _format, %AudioFormat{} = audio_format) do
    buffer = %AudioBuffer{format: audio_format, data: frame.data}
    {num, den} = stream.time_base
    # Start and length are added before rounding, so that the ends of buffers are sample-exact.
    ticks = frame.ticks * num * audio_format.rate + AudioBuffer.frames(buffer) * den
    {:audio, Nut.to_ns(ticks, {1, den * audio_format.rate}), buffer}
  end

  @doc false
  # Options that make ffmpeg deliver raw pictures or samples.
  @spec raw_video(Image.Format.t(), {pos_integer(), pos_integer()} | nil) :: [String.t()]
  def raw_video(format, size) do
    scale =
      case size do
        nil -> []
        {width, height} -> ["-vf", "scale=#{width}:#{height}"]
      end

    # Times as the file has them, in its own time base: nothing is rounded to a frame rate.
    scale ++
      ~w(-c:v rawvideo -fps_mode passthrough -enc_time_base:v #{FFmpeg.input_time_base()}) ++
      ~w(-pix_fmt #{Pixels.ffmpeg(format)})
  end

  @doc false
  # `filters` see the sound as it was decoded.
  @spec raw_audio(AudioFormat.t(), pos_integer(), [String.t()]) :: [String.t()]
  def raw_audio(%AudioFormat{} = format, buffer, filters \\ []) do
    frames = max(AudioFormat.ns_to_frames(format, buffer), 1)
    own = ["aresample=#{format.rate}", "atrim=start=0", "asetnsamples=n=#{frames}:p=0"]

    ~w(-c:a #{Pixels.codec(format.sample)} -ar #{format.rate} -ac #{format.channels}) ++
      ["-af", Enum.join(filters ++ own, ",")]
  end

  defp check_span(opts, info) do
    cond do
      opts[:end] && opts[:end] <= opts[:start] ->
        {:error,
         Error.new(:bad_option, "option :end must be after :start",
           why: "the span from #{opts[:start]} to #{opts[:end]} is empty"
         )}

      info.duration && opts[:start] >= info.duration ->
        {:error,
         Error.new(:bad_option, "option :start lies behind the end of #{info.name}",
           why: "it lasts #{Situ.Time.format_duration(info.duration)}"
         )}

      true ->
        {:ok, opts}
    end
  end

  defp check_any(nil, nil, info) do
    {:error,
     Error.new(:no_stream, "#{info.name} has nothing to read with these options",
       fix: "it has #{if info.video, do: "pictures", else: "sound"} only"
     )}
  end

  defp check_any(_video, _audio, _info), do: :ok

  defp audio_format(audio, nil),
    do: %AudioFormat{rate: audio.rate, channels: audio.channels, sample: :s16}

  defp audio_format(_audio, format), do: format

  # MP4 and its kin say exactly how long the sound is; the last frame of the codec is padded beyond it.
  defp audio_end(%{format: "mov" <> _}, %{duration: duration}), do: duration
  defp audio_end(_info, _audio), do: nil

  defp least(nil, limit), do: limit
  defp least(limit, nil), do: limit
  defp least(a, b), do: min(a, b)

  # ffmpeg counts a span from the first picture it keeps: it is asked for more, and the end is cut here.
  @spare 1_000_000_000

  defp input(path, info, opts) do
    seek = if opts[:start] > 0, do: ["-ss", seconds(opts[:start])], else: []
    span = if opts[:end], do: ["-t", seconds(opts[:end] - opts[:start] + @spare)], else: []
    loop = if opts[:loop], do: ~w(-stream_loop -1), else: []

    # The first moment of the file is media time 0; in our own files time 0 is marked, and a codec's lead-in lies
    # before.
    zero = if info.exact?, do: [], else: ["-start_at_zero"]

    ["-copyts" | zero] ++
      ~w(-threads #{opts[:threads]} -max_pixels #{opts[:max_pixels]}) ++
      seek ++ span ++ loop ++ FFmpeg.local_file(path)
  end

  defp output(video, audio, audio_format, opts) do
    map = Enum.flat_map([video, audio], &if(&1, do: ["-map", "0:#{&1.index}"], else: []))

    map ++
      ~w(-map_metadata -1 -map_chapters -1) ++
      if(video, do: raw_video(opts[:format], opts[:size]), else: []) ++
      if(audio, do: raw_audio(audio_format, opts[:audio_buffer]), else: [])
  end

  # Decimal seconds, exactly.
  defp seconds(ns) do
    fraction = ns |> rem(1_000_000_000) |> Integer.to_string() |> String.pad_leading(9, "0")
    "#{div(ns, 1_000_000_000)}.#{fraction}"
  end

  defp deliver(frame, %{streams: nil} = decoder) do
    {:ok, streams} = Reader.streams(decoder.reader)
    deliver(frame, %{decoder | streams: streams})
  end

  defp deliver(%{stream: id, time: time}, %{video: id, video_end: limit} = decoder)
       when is_integer(limit) and time >= limit,
       do: next(decoder)

  defp deliver(%{stream: id} = frame, %{video: id} = decoder) do
    {:video, time, image} = convert(frame, decoder.streams[id], decoder.format, nil)
    in_order(:video, time, image, decoder)
  end

  defp deliver(%{stream: id} = frame, %{audio: id} = decoder) do
    {:audio, time, buffer} = convert(frame, decoder.streams[id], nil, decoder.audio_format)

    case cut(buffer, time, decoder) do
      nil -> next(decoder)
      {buffer, time} -> in_order(:audio, time, buffer, decoder)
    end
  end

  defp cut(buffer, time, %{audio_end: limit, loop: loop}) when is_nil(limit) or loop,
    do: {buffer, time}

  defp cut(buffer, time, %{audio_end: limit}) when time <= limit, do: {buffer, time}

  defp cut(buffer, time, %{audio_end: limit}) do
    keep = AudioBuffer.frames(buffer) - AudioFormat.ns_to_frames(buffer.format, time - limit)
    if keep > 0, do: {AudioBuffer.slice(buffer, 0, keep), limit}
  end

  defp in_order(kind, time, data, decoder) do
    case decoder.last do
      %{^kind => last} when time <= last -> next(%{decoder | dropped: decoder.dropped + 1})
      last -> {kind, time, data, %{decoder | last: Map.put(last, kind, time)}}
    end
  end
end

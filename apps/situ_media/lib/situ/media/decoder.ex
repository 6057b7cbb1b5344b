defmodule Situ.Media.Decoder do
  @moduledoc """
  Reads images and audio from a media file in time order, without a pipeline.

      {:ok, decoder} = Situ.Media.Decoder.open("talk1.mp4", start: Situ.Time.s(2))
      {:video, 2_000_000_000, %Situ.Image{}, decoder} = Situ.Media.Decoder.next_item(decoder)
      :ok = Situ.Media.Decoder.close(decoder)

  Times are media time in nanoseconds, converted exactly from the file's own time base, with 0 at the start of the file.
  The time of an image is when it is shown, and the time of an audio buffer is when it **ends**. The times of each kind
  strictly increase: an image with a time at or before the previous one is skipped and counted in `dropped`.

  `Situ.Media.VideoFile` is the source for pipelines.
  """
  alias Situ.{AudioBuffer, AudioFormat, Error, Image}
  alias Situ.Media.{FFmpeg, FileInfo, Nut}
  alias Situ.Media.FFmpeg.FormatNames
  alias Situ.Media.FFmpeg.Reader

  @schema [
    start: [
      type: {:integer, 0, 1_000_000_000_000_000},
      default: 0,
      doc: "Media time to begin at, ns; starts with the first image at or after it."
    ],
    end: [
      type: {:optional, :pos_integer},
      default: nil,
      doc: "Media time to end before, ns; `nil`: end of the file."
    ],
    video: [type: :boolean, default: true, doc: "Read the images."],
    audio: [type: :boolean, default: true, doc: "Read the audio."],
    format: [
      type: {:in, Image.Format.list_all()},
      default: :bgr24,
      doc: "Pixel format of the images."
    ],
    size: [
      type: {:optional, {:tuple, [:pos_integer, :pos_integer]}},
      default: nil,
      doc: "`{width, height}` to scale to while decoding; `nil`: as recorded."
    ],
    audio_format: [
      type: {:optional, {:struct, AudioFormat}},
      default: nil,
      doc:
        "Convert the audio to this format; `nil`: 16-bit samples at the file's rate and channels."
    ],
    audio_buffer: [
      type: :pos_integer,
      default: 20_000_000,
      doc: "Length of an audio buffer, ns; the last may be shorter."
    ],
    max_pixels: [
      type: :pos_integer,
      default: 67_108_864,
      doc: "Reject images with more pixels, whatever the file claims."
    ],
    threads: [
      type: :non_neg_integer,
      default: 0,
      doc: "Decoder threads; 0: one per core."
    ],
    loop: [
      type: :boolean,
      default: false,
      doc: "Restart at the end of the file, with continuous times."
    ]
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

  @doc "Returns the option schema of `open/2`."
  @spec option_schema() :: Situ.Options.schema()
  def option_schema, do: @schema

  @doc """
  Starts decoding the file at `path`. The calling process owns the decoder.

  #{Situ.Options.docs(@schema)}
  """
  @spec open(Path.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(path, opts \\ []) do
    with {:ok, info} <- FileInfo.read(path), do: open(path, info, opts)
  end

  @doc "Starts decoding like `open/2`, with the result of an earlier `Situ.Media.FileInfo.read/1`."
  @spec open(Path.t(), FileInfo.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def open(path, %FileInfo{} = info, opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema),
         {:ok, opts} <- check_span(opts, info),
         video = if(opts[:video], do: info.video),
         audio = if(opts[:audio], do: info.audio),
         :ok <- check_any(video, audio, info),
         audio_format = audio && audio_format(audio, opts[:audio_format]),
         args = input_args(path, info, opts) ++ output_args(video, audio, audio_format, opts),
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
         audio_end: audio && min_limit(audio_end(info, audio), opts[:end]),
         loop: opts[:loop]
       }}
    end
  end

  @doc "Waits for the next image or audio buffer and returns it."
  @spec next_item(t()) :: item()
  def next_item(%__MODULE__{} = decoder) do
    case Reader.next_frame(decoder.reader, :infinity) do
      {:ok, frame} -> deliver_frame(frame, decoder)
      :eof -> {:eof, decoder}
      {:error, error} -> {:error, error, decoder}
    end
  end

  @doc "Stops the decoder immediately."
  @spec close(t()) :: :ok
  def close(%__MODULE__{reader: reader}), do: Reader.stop_ffmpeg(reader)

  @doc false
  # Converts a frame of the reader to an image or audio buffer. Live sources use it, too.
  @spec convert_frame(
          Nut.Demuxer.frame(),
          Nut.stream(),
          Image.Format.t() | nil,
          AudioFormat.t() | nil
        ) ::
          {:video, Situ.Time.t(), Image.t()} | {:audio, Situ.Time.t(), AudioBuffer.t()}
  def convert_frame(frame, %{class: :video} = stream, format, _audio_format) do
    image = %Image{
      width: stream.width,
      height: stream.height,
      format: format,
      stride: stream.width * Image.Format.bytes_per_pixel(format),
      data: frame.data
    }

    {:video, frame.time, image}
  end

  def convert_frame(frame, %{class: :audio} = stream, _format, %AudioFormat{} = audio_format) do
    buffer = %AudioBuffer{format: audio_format, data: frame.data}
    {num, den} = stream.time_base
    # Adds start and length before rounding, so that the ends of buffers are exact to the sample.
    ticks = frame.ticks * num * audio_format.rate + AudioBuffer.frame_count(buffer) * den
    {:audio, Nut.to_ns(ticks, {1, den * audio_format.rate}), buffer}
  end

  @doc false
  # Returns the options that make ffmpeg output raw images or samples.
  @spec raw_video(Image.Format.t(), {pos_integer(), pos_integer()} | nil) :: [String.t()]
  def raw_video(format, size) do
    scale =
      case size do
        nil -> []
        {width, height} -> ["-vf", "scale=#{width}:#{height}"]
      end

    # Keeps the times of the file in its own time base, without rounding to a frame rate.
    scale ++
      ~w(-c:v rawvideo -fps_mode passthrough -enc_time_base:v #{FFmpeg.input_time_base()}) ++
      ~w(-pix_fmt #{FormatNames.ffmpeg(format)})
  end

  @doc false
  # `filters` are applied to the audio as decoded.
  @spec raw_audio(AudioFormat.t(), pos_integer(), [String.t()]) :: [String.t()]
  def raw_audio(%AudioFormat{} = format, buffer, filters \\ []) do
    frames = max(AudioFormat.ns_to_frames(format, buffer), 1)
    own = ["aresample=#{format.rate}", "atrim=start=0", "asetnsamples=n=#{frames}:p=0"]

    ~w(-c:a #{FormatNames.codec(format.sample)} -ar #{format.rate} -ac #{format.channels}) ++
      ["-af", Enum.join(filters ++ own, ",")]
  end

  defp check_span(opts, info) do
    cond do
      opts[:end] && opts[:end] <= opts[:start] ->
        {:error,
         Error.new(:bad_option, "option :end must be after :start",
           why: "the span from #{opts[:start]} to #{opts[:end]} ns is empty"
         )}

      info.duration && opts[:start] >= info.duration ->
        {:error,
         Error.new(:bad_option, "option :start is after the end of #{info.name}",
           why: "the file lasts #{Situ.Time.format_duration(info.duration)}"
         )}

      true ->
        {:ok, opts}
    end
  end

  defp check_any(nil, nil, info) do
    {:error,
     Error.new(:no_stream, "#{info.name} has nothing to read with these options",
       fix: "read its #{if info.video, do: "images", else: "audio"}; it has no other stream"
     )}
  end

  defp check_any(_video, _audio, _info), do: :ok

  defp audio_format(audio, nil),
    do: %AudioFormat{rate: audio.rate, channels: audio.channels, sample: :s16}

  defp audio_format(_audio, format), do: format

  # MP4 and related formats state the exact audio length; the last frame of the codec is padded beyond it.
  defp audio_end(%{format: "mov" <> _}, %{duration: duration}), do: duration
  defp audio_end(_info, _audio), do: nil

  defp min_limit(nil, limit), do: limit
  defp min_limit(limit, nil), do: limit
  defp min_limit(a, b), do: min(a, b)

  # ffmpeg counts a span from the first image it keeps, so more is requested and the end is cut here.
  @spare 1_000_000_000

  defp input_args(path, info, opts) do
    seek = if opts[:start] > 0, do: ["-ss", format_seconds(opts[:start])], else: []
    span = if opts[:end], do: ["-t", format_seconds(opts[:end] - opts[:start] + @spare)], else: []
    loop = if opts[:loop], do: ~w(-stream_loop -1), else: []

    # The start of the file is media time 0. Files written by Situ mark time 0, and the lead-in of the codec comes
    # before it.
    zero = if info.exact?, do: [], else: ["-start_at_zero"]

    ["-copyts" | zero] ++
      ~w(-threads #{opts[:threads]} -max_pixels #{opts[:max_pixels]}) ++
      seek ++ span ++ loop ++ FFmpeg.local_file(path)
  end

  defp output_args(video, audio, audio_format, opts) do
    map = Enum.flat_map([video, audio], &if(&1, do: ["-map", "0:#{&1.index}"], else: []))

    map ++
      ~w(-map_metadata -1 -map_chapters -1) ++
      if(video, do: raw_video(opts[:format], opts[:size]), else: []) ++
      if(audio, do: raw_audio(audio_format, opts[:audio_buffer]), else: [])
  end

  # Formats nanoseconds as exact decimal seconds.
  defp format_seconds(ns) do
    fraction = ns |> rem(1_000_000_000) |> Integer.to_string() |> String.pad_leading(9, "0")
    "#{div(ns, 1_000_000_000)}.#{fraction}"
  end

  defp deliver_frame(frame, %{streams: nil} = decoder) do
    {:ok, streams} = Reader.fetch_streams(decoder.reader)
    deliver_frame(frame, %{decoder | streams: streams})
  end

  defp deliver_frame(%{stream: id, time: time}, %{video: id, video_end: limit} = decoder)
       when is_integer(limit) and time >= limit,
       do: next_item(decoder)

  defp deliver_frame(%{stream: id} = frame, %{video: id} = decoder) do
    {:video, time, image} = convert_frame(frame, decoder.streams[id], decoder.format, nil)
    in_order(:video, time, image, decoder)
  end

  defp deliver_frame(%{stream: id} = frame, %{audio: id} = decoder) do
    {:audio, time, buffer} = convert_frame(frame, decoder.streams[id], nil, decoder.audio_format)

    case trim_audio(buffer, time, decoder) do
      nil -> next_item(decoder)
      {buffer, time} -> in_order(:audio, time, buffer, decoder)
    end
  end

  defp trim_audio(buffer, time, %{audio_end: limit, loop: loop}) when is_nil(limit) or loop,
    do: {buffer, time}

  defp trim_audio(buffer, time, %{audio_end: limit}) when time <= limit, do: {buffer, time}

  defp trim_audio(buffer, time, %{audio_end: limit}) do
    keep = AudioBuffer.frame_count(buffer) - AudioFormat.ns_to_frames(buffer.format, time - limit)
    if keep > 0, do: {AudioBuffer.slice_frames(buffer, 0, keep), limit}
  end

  defp in_order(kind, time, data, decoder) do
    case decoder.last do
      %{^kind => last} when time <= last -> next_item(%{decoder | dropped: decoder.dropped + 1})
      last -> {kind, time, data, %{decoder | last: Map.put(last, kind, time)}}
    end
  end
end

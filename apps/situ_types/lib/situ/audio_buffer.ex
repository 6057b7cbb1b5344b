defmodule Situ.AudioBuffer do
  @moduledoc """
  A chunk of audio: interleaved samples and their `Situ.AudioFormat`.

  In a message, the **originating time is the end time of the buffer**: the moment after its last frame. Frame `i` of
  `n` spans `time - (n - i) / rate` to `time - (n - i - 1) / rate`.

      iex> buffer = Situ.AudioBuffer.from_samples([0, 16384, -16384, 0], Situ.AudioFormat.pcm(16_000))
      iex> buffer
      #Situ.AudioBuffer<4 frames, 250 us, 16000 Hz, 1 ch, :s16>
      iex> Situ.AudioBuffer.to_samples(buffer)
      [0, 16384, -16384, 0]
  """
  @behaviour Situ.Codec

  alias Situ.{AudioFormat, Error}

  @enforce_keys [:format, :data]
  defstruct [:format, :data]

  @type t :: %__MODULE__{format: AudioFormat.t(), data: binary()}
  @type result :: {:ok, t()} | {:error, Error.t()}

  @schema [
    format: [
      type: {:struct, AudioFormat},
      default: Macro.escape(%AudioFormat{}),
      doc: "The sample format of `data`."
    ],
    data: [type: :string, required: true, doc: "Complete frames, interleaved, little-endian."]
  ]

  @doc """
  Builds a validated buffer without copying `data`.

      iex> {:error, error} = Situ.AudioBuffer.new(format: Situ.AudioFormat.pcm(8_000, 2), data: <<1, 2, 3>>)
      iex> error.what
      "3 bytes are not whole frames of 4 bytes (8000 Hz, 2 channels, :s16)"
  """
  @spec new(keyword()) :: result()
  def new(opts) do
    opts = Keyword.put_new(opts, :format, %AudioFormat{})

    with {:ok, opts} <- Situ.Options.validate(opts, @schema) do
      validate(struct!(__MODULE__, opts))
    end
  end

  @doc "Like `new/1`, but returns the buffer or raises the error."
  @spec new!(keyword()) :: t()
  def new!(opts), do: Situ.Error.unwrap!(new(opts))

  @doc "Validates a struct that was built by hand."
  @spec validate(t()) :: result()
  def validate(%__MODULE__{format: %AudioFormat{} = format, data: data} = buffer)
      when is_binary(data) do
    with {:ok, _} <- AudioFormat.validate(format) do
      size = AudioFormat.bytes_per_frame(format)

      if rem(byte_size(data), size) == 0 do
        {:ok, buffer}
      else
        audio_error(
          "#{byte_size(data)} bytes are not whole frames of #{size} bytes " <>
            "(#{format.rate} Hz, #{format.channels} channels, #{inspect(format.sample)})"
        )
      end
    end
  end

  def validate(%__MODULE__{}),
    do: audio_error("an audio buffer needs a Situ.AudioFormat and a binary")

  @doc """
  Builds a buffer of silence.

      iex> Situ.AudioBuffer.build_silence(Situ.AudioFormat.pcm(8_000, 1, :u8), 2).data
      <<128, 128>>
  """
  @spec build_silence(AudioFormat.t(), non_neg_integer()) :: t()
  def build_silence(%AudioFormat{} = format, frames) when is_integer(frames) and frames >= 0 do
    byte = if format.sample == :u8, do: <<128>>, else: <<0>>

    %__MODULE__{
      format: format,
      data: :binary.copy(byte, frames * AudioFormat.bytes_per_frame(format))
    }
  end

  @doc "Returns the number of frames in the buffer."
  @spec frame_count(t()) :: non_neg_integer()
  def frame_count(%__MODULE__{} = b),
    do: div(byte_size(b.data), AudioFormat.bytes_per_frame(b.format))

  @doc """
  Returns the duration of the buffer in nanoseconds.

      iex> Situ.AudioBuffer.duration_ns(Situ.AudioBuffer.build_silence(Situ.AudioFormat.pcm(16_000), 320))
      20_000_000
  """
  @spec duration_ns(t()) :: Situ.Time.duration()
  def duration_ns(%__MODULE__{} = b), do: AudioFormat.frames_to_ns(b.format, frame_count(b))

  @doc "Returns the start time of a buffer that ends at `originating_time`."
  @spec start_time(t(), Situ.Time.t()) :: Situ.Time.t()
  def start_time(%__MODULE__{} = b, originating_time), do: originating_time - duration_ns(b)

  @doc """
  Concatenates buffers that have the same format.

      iex> one = Situ.AudioBuffer.from_samples([1], Situ.AudioFormat.pcm())
      iex> {:ok, two} = Situ.AudioBuffer.concat([one, one])
      iex> Situ.AudioBuffer.to_samples(two)
      [1, 1]
  """
  @spec concat([t(), ...]) :: result()
  def concat([%__MODULE__{format: format} | _] = buffers) do
    case Enum.find(buffers, &(&1.format != format)) do
      nil ->
        {:ok,
         %__MODULE__{format: format, data: IO.iodata_to_binary(Enum.map(buffers, & &1.data))}}

      other ->
        audio_error("cannot append #{inspect(other.format)} to #{inspect(format)}")
    end
  end

  @doc """
  Returns up to `count` frames, starting at frame `first`. The result shares memory with the buffer.
  """
  @spec slice_frames(t(), non_neg_integer(), non_neg_integer()) :: t()
  def slice_frames(%__MODULE__{} = b, first, count) when first >= 0 and count >= 0 do
    total = frame_count(b)
    first = min(first, total)
    size = AudioFormat.bytes_per_frame(b.format)
    %{b | data: binary_part(b.data, first * size, min(count, total - first) * size)}
  end

  @doc """
  Returns the interleaved sample values as a list. Intended for tests and short buffers; for real audio, use the audio
  operators.
  """
  @spec to_samples(t()) :: [number()]
  def to_samples(%__MODULE__{format: %{sample: sample}, data: data}) do
    case sample do
      :u8 -> :binary.bin_to_list(data)
      :s16 -> for <<v::little-signed-16 <- data>>, do: v
      :s24 -> for <<v::little-signed-24 <- data>>, do: v
      :s32 -> for <<v::little-signed-32 <- data>>, do: v
      :f32 -> for <<v::little-float-32 <- data>>, do: v
      :f64 -> for <<v::little-float-64 <- data>>, do: v
    end
  end

  @doc "Builds a buffer from interleaved sample values in the range of the format."
  @spec from_samples([number()], AudioFormat.t()) :: t()
  def from_samples(values, %AudioFormat{sample: sample} = format) do
    data =
      case sample do
        :u8 -> for v <- values, into: <<>>, do: <<v>>
        :s16 -> for v <- values, into: <<>>, do: <<v::little-16>>
        :s24 -> for v <- values, into: <<>>, do: <<v::little-24>>
        :s32 -> for v <- values, into: <<>>, do: <<v::little-32>>
        :f32 -> for v <- values, into: <<>>, do: <<v::little-float-32>>
        :f64 -> for v <- values, into: <<>>, do: <<v::little-float-64>>
      end

    new!(format: format, data: data)
  end

  @impl Situ.Codec
  def codec_name, do: "situ.audio_buffer"

  @impl Situ.Codec
  def encode(%__MODULE__{format: format, data: data}) do
    [
      <<1, AudioFormat.code(format.sample), format.channels::little-16, format.rate::little-32,
        0::64>>,
      data
    ]
  end

  @impl Situ.Codec
  def decode(<<1, code, channels::little-16, rate::little-32, _::64, data::binary>>) do
    with {:ok, sample} <- AudioFormat.sample_from_code(code) do
      validate(%__MODULE__{
        format: %AudioFormat{rate: rate, channels: channels, sample: sample},
        data: data
      })
    end
  end

  def decode(_), do: audio_error("not a stored audio buffer")

  @doc """
  Returns the waveform as points of one millisecond each. A point holds its start time, then the minimum, maximum and
  last value over all channels (full scale is 1.0), and the number of frames.

      iex> buffer = Situ.AudioBuffer.from_samples([0, 16384, -16384], Situ.AudioFormat.pcm(2000))
      iex> Situ.AudioBuffer.points(buffer, 1_500_000)
      [{0, 0.0, 0.5, 0.5, 2}, {1_000_000, -0.5, -0.5, -0.5, 1}]
  """
  @impl Situ.Codec
  def points(%__MODULE__{format: format} = buffer, originating_time) do
    span = max(div(format.rate, 1000), 1)
    bytes = span * AudioFormat.bytes_per_frame(format)
    collect_points(buffer, start_time(buffer, originating_time), span, bytes, 0)
  end

  defp collect_points(%{data: <<>>}, _start, _span, _bytes, _i), do: []

  defp collect_points(%{format: format, data: data} = buffer, start, span, bytes, i) do
    {piece, rest} = split_bytes(data, bytes)
    time = start + AudioFormat.frames_to_ns(format, i * span)
    later = collect_points(%{buffer | data: rest}, start, span, bytes, i + 1)

    frames = div(byte_size(piece), AudioFormat.bytes_per_frame(format))

    # Samples that are not finite numbers cannot be drawn.
    case to_samples(%{buffer | data: piece}) do
      [] ->
        later

      [first | samples] ->
        {min, max, last} = find_extremes(samples, first, first, first)
        scale = &full_scale(format.sample, &1)
        [{time, scale.(min), scale.(max), scale.(last), frames} | later]
    end
  end

  defp split_bytes(data, bytes) when byte_size(data) <= bytes, do: {data, <<>>}
  defp split_bytes(data, bytes), do: :erlang.split_binary(data, bytes)

  defp find_extremes([v | rest], min, max, _) when v < min, do: find_extremes(rest, v, max, v)
  defp find_extremes([v | rest], min, max, _) when v > max, do: find_extremes(rest, min, v, v)
  defp find_extremes([v | rest], min, max, _), do: find_extremes(rest, min, max, v)
  defp find_extremes([], min, max, last), do: {min, max, last}

  defp full_scale(:u8, v), do: (v - 128) / 128
  defp full_scale(:s16, v), do: v / 32_768
  defp full_scale(:s24, v), do: v / 8_388_608
  defp full_scale(:s32, v), do: v / 2_147_483_648
  defp full_scale(_float, v), do: v

  defp audio_error(what), do: {:error, Error.new(:bad_audio, what)}

  defimpl Inspect do
    def inspect(%{format: %Situ.AudioFormat{} = f, data: data} = buffer, _opts)
        when is_binary(data) do
      "#Situ.AudioBuffer<#{Situ.AudioBuffer.frame_count(buffer)} frames, " <>
        "#{Situ.Time.format_duration(Situ.AudioBuffer.duration_ns(buffer))}, #{f.rate} Hz, " <>
        "#{f.channels} ch, #{inspect(f.sample)}>"
    rescue
      _ -> "#Situ.AudioBuffer<invalid>"
    end

    def inspect(_, _opts), do: "#Situ.AudioBuffer<invalid>"
  end
end

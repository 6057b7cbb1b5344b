defmodule Situ.Infer.Voice.Chunker do
  @moduledoc false
  # Cuts 16 kHz mono audio into chunks of a fixed number of samples, as 32-bit floats with the time of each chunk's end.
  # A gap in the audio drops the incomplete chunk before it, so a chunk never spans a gap.
  alias Situ.{AudioBuffer, AudioFormat, Error}
  alias Situ.Infer.SampleCheck

  @rate 16_000
  @sample_ns 62_500
  # The times of devices jitter by a few milliseconds; a gap is longer than that.
  @gap_ns 100_000_000

  @enforce_keys [:samples]
  defstruct [:samples, rest: <<>>, end: nil, last: nil]

  def new(samples), do: %__MODULE__{samples: samples}

  @doc "Adds the buffer that ended at `time`; returns its chunks `{end_time, floats}`, and whether a gap preceded it."
  @spec push(%__MODULE__{}, AudioBuffer.t(), Situ.Time.t()) ::
          {:ok, [{Situ.Time.t(), binary()}], gap? :: boolean(), %__MODULE__{}}
          | {:error, Error.t()}
  def push(chunker, %AudioBuffer{format: format} = buffer, time) do
    with :ok <- check_format(format), :ok <- SampleCheck.check_buffer(buffer) do
      start = time - AudioBuffer.frame_count(buffer) * @sample_ns
      gap? = chunker.end != nil and start - chunker.end > @gap_ns
      rest = if gap?, do: <<>>, else: chunker.rest
      bytes = rest <> to_floats(buffer)
      {chunks, rest} = cut_chunks(bytes, chunker.samples * 4, [])
      {chunks, last} = stamp_chunks(chunks, time - div(byte_size(rest), 4) * @sample_ns, chunker)
      {:ok, chunks, gap?, %{chunker | rest: rest, end: time, last: last}}
    end
  end

  @doc "Returns the length of one chunk in nanoseconds."
  def length_ns(%__MODULE__{samples: samples}), do: samples * @sample_ns

  @doc "Computes the root mean square of a chunk of floats."
  @spec rms_level(binary()) :: float()
  def rms_level(floats),
    do: :math.sqrt(sum_squares(floats, 0.0) / max(div(byte_size(floats), 4), 1))

  defp sum_squares(<<x::float-native-32, rest::binary>>, sum), do: sum_squares(rest, sum + x * x)
  defp sum_squares(<<_::32, rest::binary>>, sum), do: sum_squares(rest, sum)
  defp sum_squares(<<>>, sum), do: sum

  defp cut_chunks(bytes, size, chunks) when byte_size(bytes) >= size do
    rest = binary_part(bytes, size, byte_size(bytes) - size)
    cut_chunks(rest, size, [binary_part(bytes, 0, size) | chunks])
  end

  defp cut_chunks(rest, _size, chunks), do: {chunks, :binary.copy(rest)}

  # Takes the newest chunk first and returns the oldest first. Times always increase, even if a device clock steps back.
  defp stamp_chunks(newest_first, end_time, chunker) do
    step = length_ns(chunker)

    newest_first
    |> Enum.with_index(fn chunk, i -> {end_time - i * step, chunk} end)
    |> Enum.reverse()
    |> Enum.map_reduce(chunker.last, fn {time, chunk}, last ->
      time = if last == nil or time > last, do: time, else: last + 1
      {{time, chunk}, time}
    end)
  end

  defp to_floats(%AudioBuffer{format: %{sample: :f32}, data: data}), do: data

  defp to_floats(%AudioBuffer{data: data}) do
    for <<s::little-signed-16 <- data>>, into: <<>>, do: <<s / 32_768::float-native-32>>
  end

  defp check_format(%AudioFormat{rate: @rate, channels: 1, sample: sample})
       when sample in [:s16, :f32],
       do: :ok

  defp check_format(format) do
    {:error,
     Error.new(
       :bad_audio_format,
       "voice activity takes 16 kHz mono audio, got #{inspect(format)}",
       fix: "put Situ.AudioStream.resample(16_000) in front of it"
     )}
  end
end

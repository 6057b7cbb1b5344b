defmodule Situ.AudioFormat do
  @moduledoc """
  Describes audio data: sample rate, channel count and sample type.

  Channels are interleaved, little-endian. A *frame* is one sample of every channel.

  | sample | bytes | range |
  |---|---|---|
  | `:u8` | 1 | 0..255, silence is 128 |
  | `:s16` | 2 | -32768..32767 |
  | `:s24` | 3 | packed, -2^23..2^23-1 |
  | `:s32` | 4 | -2^31..2^31-1 |
  | `:f32`, `:f64` | 4, 8 | -1.0..1.0 |

      iex> Situ.AudioFormat.pcm(48_000, 2)
      #Situ.AudioFormat<48000 Hz, 2 ch, :s16>
      iex> Situ.AudioFormat.bytes_per_frame(Situ.AudioFormat.pcm(48_000, 2))
      4
  """
  alias Situ.Error

  defstruct rate: 16_000, channels: 1, sample: :s16

  @type sample :: :u8 | :s16 | :s24 | :s32 | :f32 | :f64
  @type t :: %__MODULE__{rate: pos_integer(), channels: pos_integer(), sample: sample()}

  @samples [u8: 1, s16: 2, s24: 3, s32: 4, f32: 4, f64: 8]
  @codes Enum.with_index(Keyword.keys(@samples), 1)

  @schema [
    rate: [type: {:integer, 1, 16_000_000}, default: 16_000, doc: "Sample rate in Hz."],
    channels: [type: {:integer, 1, 1024}, default: 1, doc: "Number of interleaved channels."],
    sample: [type: {:in, Keyword.keys(@samples)}, default: :s16, doc: "Sample type."]
  ]

  @doc """
  Builds a validated format. The defaults are 16 kHz, mono, 16 bit.

  #{Situ.Options.docs(@schema)}

      iex> Situ.AudioFormat.new(rate: 8000)
      {:ok, %Situ.AudioFormat{rate: 8000, channels: 1, sample: :s16}}
      iex> {:error, error} = Situ.AudioFormat.new(rate: 0)
      iex> error.code
      :bad_option
  """
  @spec new(keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @schema) do
      validate(struct!(__MODULE__, opts))
    end
  end

  @doc """
  Builds a format from its three values. Raises `ArgumentError` if a value is out of range.

      iex> Situ.AudioFormat.pcm(16_000, 1, :f32).sample
      :f32
  """
  @spec pcm(pos_integer(), pos_integer(), sample()) :: t()
  def pcm(rate \\ 16_000, channels \\ 1, sample \\ :s16) do
    case validate(%__MODULE__{rate: rate, channels: channels, sample: sample}) do
      {:ok, format} -> format
      {:error, error} -> raise ArgumentError, error.what
    end
  end

  @doc "Validates a struct that was built by hand."
  @spec validate(t()) :: {:ok, t()} | {:error, Error.t()}
  def validate(%__MODULE__{rate: rate, channels: channels, sample: sample} = format) do
    cond do
      not (is_integer(rate) and rate in 1..16_000_000) ->
        format_error("sample rate #{inspect(rate)} Hz is out of range (1 to 16,000,000)")

      not (is_integer(channels) and channels in 1..1024) ->
        format_error("channel count #{inspect(channels)} is out of range (1 to 1024)")

      not Keyword.has_key?(@samples, sample) ->
        format_error(
          "unknown sample type #{inspect(sample)}, known: #{inspect(Keyword.keys(@samples))}"
        )

      true ->
        {:ok, format}
    end
  end

  @doc "Lists all sample types."
  @spec sample_types() :: [sample()]
  def sample_types, do: Keyword.keys(@samples)

  @doc "Returns the number of bytes in one sample of one channel."
  @spec bytes_per_sample(t() | sample()) :: pos_integer()
  def bytes_per_sample(%__MODULE__{sample: sample}), do: bytes_per_sample(sample)
  for {sample, bytes} <- @samples, do: def(bytes_per_sample(unquote(sample)), do: unquote(bytes))

  @doc "Returns the number of bytes in one frame (all channels)."
  @spec bytes_per_frame(t()) :: pos_integer()
  def bytes_per_frame(%__MODULE__{} = f), do: f.channels * bytes_per_sample(f.sample)

  @doc "Returns the number of bytes in one second of audio."
  @spec bytes_per_second(t()) :: pos_integer()
  def bytes_per_second(%__MODULE__{} = f), do: f.rate * bytes_per_frame(f)

  @doc """
  Converts a number of frames to nanoseconds, rounded to the nearest.

      iex> Situ.AudioFormat.frames_to_ns(Situ.AudioFormat.pcm(44_100), 441)
      10_000_000
  """
  @spec frames_to_ns(t() | pos_integer(), integer()) :: Situ.Time.duration()
  def frames_to_ns(%__MODULE__{rate: rate}, frames), do: frames_to_ns(rate, frames)

  def frames_to_ns(rate, frames) when is_integer(rate),
    do: Integer.floor_div(frames * 1_000_000_000 + div(rate, 2), rate)

  @doc """
  Converts a duration to a number of frames, rounded to the nearest.

      iex> Situ.AudioFormat.ns_to_frames(Situ.AudioFormat.pcm(16_000), Situ.Time.ms(20))
      320
  """
  @spec ns_to_frames(t() | pos_integer(), Situ.Time.duration()) :: integer()
  def ns_to_frames(%__MODULE__{rate: rate}, ns), do: ns_to_frames(rate, ns)

  def ns_to_frames(rate, ns) when is_integer(rate),
    do: Integer.floor_div(ns * rate + 500_000_000, 1_000_000_000)

  @doc false
  @spec code(sample()) :: byte()
  for {sample, code} <- @codes, do: def(code(unquote(sample)), do: unquote(code))

  @doc false
  @spec sample_from_code(byte()) :: {:ok, sample()} | {:error, Error.t()}
  for {sample, code} <- @codes do
    def sample_from_code(unquote(code)), do: {:ok, unquote(sample)}
  end

  def sample_from_code(code), do: format_error("sample type code #{code} is unknown")

  defp format_error(what), do: {:error, Error.new(:bad_audio_format, what)}

  defimpl Inspect do
    def inspect(f, _opts) do
      "#Situ.AudioFormat<#{inspect(f.rate)} Hz, #{inspect(f.channels)} ch, #{inspect(f.sample)}>"
    end
  end
end

defmodule Situ.AudioOps do
  @moduledoc """
  Operations on audio buffers: resample, mix, convert channels and sample types, and measure the level.

  Every function takes a `Situ.AudioBuffer` first and returns `{:ok, result}` or `{:error, %Situ.Error{}}`. The variant
  with `!` returns the result or raises. `Situ.AudioStream` has the same operations for streams, with the same names and
  options.

      iex> stereo = Situ.AudioBuffer.build_silence(Situ.AudioFormat.pcm(48_000, 2), 480)
      iex> stereo |> Situ.AudioOps.reformat!(channels: 1, sample: :f32) |> Situ.AudioOps.resample!(16_000)
      #Situ.AudioBuffer<160 frames, 10.0 ms, 16000 Hz, 1 ch, :f32>
  """
  alias Situ.{AudioBuffer, Error}
  alias Situ.AudioOps.Channels
  alias Situ.AudioStream.{Level, Resampler}

  @doc """
  Resamples a complete buffer to another rate in frames per second.

  #{Situ.Options.docs(Keyword.delete(Resampler.options(), :rate))}

      iex> buffer = Situ.AudioBuffer.build_silence(Situ.AudioFormat.pcm(48_000), 480)
      iex> Situ.AudioOps.resample!(buffer, 16_000) |> Situ.AudioBuffer.frame_count()
      160
  """
  @spec resample(AudioBuffer.t(), pos_integer(), keyword()) :: AudioBuffer.result()
  def resample(%AudioBuffer{} = buffer, rate, opts \\ []),
    do: Resampler.resample_buffer(buffer, rate, opts)

  @doc """
  Converts a buffer to another sample type and number of channels at the same rate. One channel is copied to several,
  and several channels are averaged to one. All other changes need `remix/3`.

  Options: `channels:`, and `sample:`, one of `:u8`, `:s16`, `:s24`, `:s32`, `:f32` and `:f64`. Both default to the
  buffer's own.

      iex> stereo = Situ.AudioBuffer.from_samples([100, 300], Situ.AudioFormat.pcm(16_000, 2))
      iex> {:ok, mono} = Situ.AudioOps.reformat(stereo, channels: 1, sample: :s32)
      iex> Situ.AudioBuffer.to_samples(mono)
      [200 * 65_536]
  """
  @spec reformat(AudioBuffer.t(), keyword()) :: AudioBuffer.result()
  defdelegate reformat(buffer, opts), to: Channels

  @doc """
  Mixes channels by a matrix with one list of input gains for each output channel. For `sample:`, see `reformat/2`.

      iex> stereo = Situ.AudioBuffer.from_samples([1, 2, 3, 4], Situ.AudioFormat.pcm(16_000, 2))
      iex> {:ok, swapped} = Situ.AudioOps.remix(stereo, [[0, 1], [1, 0]])
      iex> Situ.AudioBuffer.to_samples(swapped)
      [2, 1, 4, 3]
  """
  @spec remix(AudioBuffer.t(), [[number()]], keyword()) :: AudioBuffer.result()
  defdelegate remix(buffer, matrix, opts \\ []), to: Channels

  @doc """
  Selects the channels with these numbers (0 is the first), in this order.

      iex> stereo = Situ.AudioBuffer.from_samples([1, 2, 3, 4], Situ.AudioFormat.pcm(16_000, 2))
      iex> Situ.AudioOps.select_channels!(stereo, [1]) |> Situ.AudioBuffer.to_samples()
      [2, 4]
  """
  @spec select_channels(AudioBuffer.t(), [non_neg_integer()]) :: AudioBuffer.result()
  defdelegate select_channels(buffer, channels), to: Channels

  @doc """
  Changes the volume. `gain` is a factor, or `{:db, n}` in decibels.

      iex> buffer = Situ.AudioBuffer.from_samples([100, 30_000], Situ.AudioFormat.pcm())
      iex> Situ.AudioOps.gain!(buffer, 2) |> Situ.AudioBuffer.to_samples()
      [200, 32_767]
  """
  @spec gain(AudioBuffer.t(), number() | {:db, number()}) :: AudioBuffer.result()
  defdelegate gain(buffer, gain), to: Channels

  @doc """
  Adds two buffers of the same format, the second multiplied by `gain:` (default 1.0). The tail of the longer one is
  kept.

      iex> format = Situ.AudioFormat.pcm()
      iex> {a, b} = {Situ.AudioBuffer.from_samples([1, 2], format), Situ.AudioBuffer.from_samples([10], format)}
      iex> Situ.AudioOps.mix!(a, b) |> Situ.AudioBuffer.to_samples()
      [11, 2]
  """
  @spec mix(AudioBuffer.t(), AudioBuffer.t(), keyword()) :: AudioBuffer.result()
  defdelegate mix(a, b, opts \\ []), to: Channels

  @doc """
  Measures the level as a struct with these fields:

  | field | value |
  |---|---|
  | `peak` | peak of the loudest channel; 1.0 is full scale |
  | `rms` | root mean square of all channels |
  | `peak_db`, `rms_db` | the same in decibels of full scale, at least -120.0 |
  | `channels` | `{peak, rms}` of each channel |

      iex> buffer = Situ.AudioBuffer.from_samples([16_384, -16_384], Situ.AudioFormat.pcm())
      iex> {:ok, level} = Situ.AudioOps.level(buffer)
      iex> {level.peak, level.rms, Float.round(level.rms_db, 2)}
      {0.5, 0.5, -6.02}
  """
  @spec level(AudioBuffer.t()) :: {:ok, Level.t()} | {:error, Error.t()}
  defdelegate level(buffer), to: Channels

  @doc """
  Computes the waveform like `Situ.AudioBuffer.points/2`, but in a native kernel that is fast enough for complete files.

      iex> buffer = Situ.AudioBuffer.from_samples([0, 16384, -16384], Situ.AudioFormat.pcm(2000))
      iex> Situ.AudioOps.points(buffer, 1_500_000)
      {:ok, [{0, 0.0, 0.5, 0.5, 2}, {1_000_000, -0.5, -0.5, -0.5, 1}]}
  """
  @spec points(AudioBuffer.t(), Situ.Time.t()) ::
          {:ok, [Situ.Codec.point()]} | {:error, Error.t()}
  defdelegate points(buffer, originating_time), to: Channels

  for {name, arity} <-
        [resample: 2, resample: 3, reformat: 2, remix: 2, remix: 3, select_channels: 2] ++
          [gain: 2, mix: 2, mix: 3, level: 1, points: 2] do
    args = Macro.generate_arguments(arity, __MODULE__)
    types = List.duplicate(quote(do: term()), arity)

    @doc "Calls `#{name}/#{arity}` and returns the value or raises the `Situ.Error`."
    @spec unquote(:"#{name}!")(unquote_splicing(types)) :: term()
    def unquote(:"#{name}!")(unquote_splicing(args)),
      do: Error.unwrap!(unquote(name)(unquote_splicing(args)))
  end
end

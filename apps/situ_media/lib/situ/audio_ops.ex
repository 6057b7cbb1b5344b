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
  alias Situ.AudioBuffer
  alias Situ.AudioOps.Channels

  @doc """
  Resamples a complete buffer to another rate. For `quality:`, see `Situ.AudioStream.Resampler`.

      iex> buffer = Situ.AudioBuffer.build_silence(Situ.AudioFormat.pcm(48_000), 480)
      iex> Situ.AudioOps.resample!(buffer, 16_000) |> Situ.AudioBuffer.frame_count()
      160
  """
  @spec resample(AudioBuffer.t(), pos_integer(), keyword()) :: AudioBuffer.result()
  def resample(%AudioBuffer{} = buffer, rate, opts \\ []),
    do: Situ.AudioStream.Resampler.resample_buffer(buffer, rate, opts)

  defdelegate reformat(buffer, opts), to: Channels
  defdelegate remix(buffer, matrix, opts \\ []), to: Channels
  defdelegate select_channels(buffer, channels), to: Channels
  defdelegate gain(buffer, gain), to: Channels
  defdelegate mix(a, b, opts \\ []), to: Channels
  defdelegate level(buffer), to: Channels
  defdelegate points(buffer, originating_time), to: Channels

  for {name, arity} <-
        [resample: 2, resample: 3, reformat: 2, remix: 2, remix: 3, select_channels: 2] ++
          [gain: 2, mix: 2, mix: 3, level: 1, points: 2] do
    args = Macro.generate_arguments(arity, __MODULE__)
    types = List.duplicate(quote(do: term()), arity)

    @doc "Calls `#{name}/#{arity}` and returns the value or raises the `Situ.Error`."
    @spec unquote(:"#{name}!")(unquote_splicing(types)) :: term()
    def unquote(:"#{name}!")(unquote_splicing(args)),
      do: Situ.Error.unwrap!(unquote(name)(unquote_splicing(args)))
  end
end

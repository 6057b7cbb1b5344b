defmodule Situ.AudioStream.Ramp do
  @moduledoc false
  # Changes a gain linearly from one value to another over the frames of a buffer, so that
  # operators can change the volume without clicks. Pure.
  alias Situ.{AudioBuffer, AudioOps}

  @doc """
  Multiplies the buffer by a factor that reaches `to` at its last frame and was `from` one frame before its first.

      iex> buffer = Situ.AudioBuffer.from_samples([100, 100, 100, 100], Situ.AudioFormat.pcm())
      iex> Situ.AudioStream.Ramp.scale_buffer(buffer, 0.0, 1.0) |> Situ.AudioBuffer.to_samples()
      [25, 50, 75, 100]
  """
  @spec scale_buffer(AudioBuffer.t(), float(), float()) :: AudioBuffer.t()
  def scale_buffer(buffer, from, to) when from == 1.0 and to == 1.0, do: buffer
  def scale_buffer(buffer, same, same), do: AudioOps.gain!(buffer, same)

  def scale_buffer(%AudioBuffer{format: format} = buffer, from, to) do
    step = (to - from) / max(AudioBuffer.frame_count(buffer), 1)

    samples =
      buffer
      |> AudioBuffer.to_samples()
      |> Enum.with_index(fn sample, i ->
        scale_sample(sample, from + step * (div(i, format.channels) + 1))
      end)

    AudioBuffer.from_samples(samples, format)
  end

  defp scale_sample(sample, factor) when is_integer(sample), do: round(sample * factor)
  defp scale_sample(sample, factor), do: sample * factor

  @doc """
  Moves a factor toward `target` for `duration` ns. The factor changes by at most 1 in `rise` ns upwards or `fall` ns
  downwards.

      iex> Situ.AudioStream.Ramp.step_toward(0.0, 1.0, 5, 20, 40)
      0.25
  """
  @spec step_toward(float(), float(), pos_integer(), non_neg_integer(), non_neg_integer()) ::
          float()
  def step_toward(now, target, duration, rise, _fall) when target > now,
    do: min(target, now + duration / max(rise, 1))

  def step_toward(now, target, duration, _rise, fall),
    do: max(target, now - duration / max(fall, 1))
end

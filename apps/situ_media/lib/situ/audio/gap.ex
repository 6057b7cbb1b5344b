defmodule Situ.Audio.Gap do
  @moduledoc false
  # Silence where times leave a gap, but only as much as a gap can be: a clock that is set while a device runs makes
  # times jump by decades, and the silence would take all memory.

  alias Situ.{AudioBuffer, AudioFormat, Error}

  # 2 h 20 min of 16 kHz speech, 23 min of 48 kHz stereo.
  @max_bytes 268_435_456

  @doc "Raises when so many frames are too much for a gap."
  @spec check!(AudioFormat.t(), integer()) :: :ok
  def check!(format, frames) do
    if frames * AudioFormat.bytes_per_frame(format) > @max_bytes,
      do: raise(too_long(format, frames)),
      else: :ok
  end

  @doc "Silence for a gap."
  @spec silence!(AudioFormat.t(), non_neg_integer()) :: AudioBuffer.t()
  def silence!(format, frames) do
    check!(format, frames)
    AudioBuffer.silence(format, frames)
  end

  defp too_long(format, frames) do
    gap = Situ.Time.format_duration(AudioFormat.frames_to_ns(format, frames))

    Error.new(:gap_too_long, "the times of the sound jump by #{gap}",
      why: "the silence in between would take more than #{div(@max_bytes, 1_048_576)} MiB",
      fix: "end one stream and start another where the clock was set or the device was away"
    )
  end
end

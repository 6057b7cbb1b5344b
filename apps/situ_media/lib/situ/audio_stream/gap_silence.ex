defmodule Situ.AudioStream.GapSilence do
  @moduledoc false
  # Fills gaps between timestamps with silence, up to a limit. If a clock is set while a device is running, times can
  # jump by decades, and that much silence would take all memory.

  alias Situ.{AudioBuffer, AudioFormat, Error}

  # 2 h 20 min of 16 kHz speech, 23 min of 48 kHz stereo.
  @max_bytes 268_435_456

  @doc "Raises `Situ.Error` if a gap of `frames` frames is too long to fill."
  @spec check_length!(AudioFormat.t(), integer()) :: :ok
  def check_length!(format, frames) do
    if frames * AudioFormat.bytes_per_frame(format) > @max_bytes,
      do: raise(too_long(format, frames)),
      else: :ok
  end

  @doc "Builds the silence that fills a gap of `frames` frames."
  @spec build_silence!(AudioFormat.t(), non_neg_integer()) :: AudioBuffer.t()
  def build_silence!(format, frames) do
    check_length!(format, frames)
    AudioBuffer.build_silence(format, frames)
  end

  defp too_long(format, frames) do
    gap = Situ.Time.format_duration(AudioFormat.frames_to_ns(format, frames))

    Error.new(:gap_too_long, "the timestamps of the audio jump by #{gap}",
      why: "the silence to fill this gap would take more than #{div(@max_bytes, 1_048_576)} MiB",
      fix: "start a new stream after the clock was set or the device was disconnected"
    )
  end
end

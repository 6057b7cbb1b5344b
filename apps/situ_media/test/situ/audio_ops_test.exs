defmodule Situ.AudioOpsTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{AudioBuffer, AudioFormat, AudioOps}
  doctest Situ.AudioOps

  property "the kernel's waveform equals the slow reference's" do
    forall {bytes, channels, sample, rate} <-
             {binary(), integer(1, 3), one_of([:u8, :s16, :s24, :s32]), integer(500, 9000)} do
      format = AudioFormat.pcm(rate, channels, sample)
      size = AudioFormat.bytes_per_frame(format)
      data = binary_part(bytes, 0, div(byte_size(bytes), size) * size)
      buffer = AudioBuffer.new!(format: format, data: data)
      AudioOps.points!(buffer, 1_000_000_000) == AudioBuffer.points(buffer, 1_000_000_000)
    end
  end
end

defmodule Situ.AudioBufferTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{AudioBuffer, AudioFormat}
  doctest Situ.AudioBuffer

  property "codecs round-trip valid buffers and refuse truncated ones" do
    forall {bytes, channels, sample} <-
             {binary(), integer(1, 3), one_of(AudioFormat.sample_types())} do
      format = AudioFormat.pcm(16_000, channels, sample)
      size = AudioFormat.bytes_per_frame(format)

      buffer =
        AudioBuffer.new!(
          format: format,
          data: binary_part(bytes, 0, div(byte_size(bytes), size) * size)
        )

      stored = IO.iodata_to_binary(AudioBuffer.encode(buffer))

      AudioBuffer.decode(stored) == {:ok, buffer} and
        match?({:error, _}, AudioBuffer.decode(binary_part(stored, 0, 15)))
    end
  end

  property "a corrupted buffer decodes to an error or a valid buffer and never crashes" do
    forall bytes <- binary() do
      case AudioBuffer.decode(<<1, bytes::binary>>) do
        {:ok, buffer} ->
          match?({:ok, _}, AudioBuffer.validate(buffer)) and
            is_list(AudioBuffer.points(buffer, 0))

        {:error, error} ->
          is_exception(error)
      end
    end
  end

  test "the waveform omits samples that are not numbers" do
    buffer = %AudioBuffer{
      format: AudioFormat.pcm(1000, 1, :f32),
      data: <<-1::32, 0.5::little-float-32>>
    }

    assert AudioBuffer.points(buffer, 2_000_000) == [{1_000_000, 0.5, 0.5, 0.5, 1}]
  end
end

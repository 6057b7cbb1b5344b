defmodule Situ.Infer.Task.AnonymiseTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{AudioBuffer, AudioFormat}
  alias Situ.Infer.Task.Anonymise

  doctest Anonymise

  @s 1_000_000_000

  property "mutes the audio within a span and leaves the rest unchanged" do
    forall {rate, sample, from, length} <-
             {one_of([100, 8_000, 44_100]), one_of([:u8, :s16, :s24, :f32]), integer(-500, 1_500),
              integer(1, 900)} do
      format = AudioFormat.pcm(rate, 2, sample)
      size = AudioFormat.bytes_per_frame(format)
      frames = div(rate, 2)
      buffer = AudioBuffer.new!(format: format, data: :binary.copy(<<7>>, frames * size))
      {from, to} = {from * 1_000_000, (from + length) * 1_000_000}
      muted = Anonymise.mute_spans(buffer, @s, [{from, to}])
      silence = :binary.copy(if(sample == :u8, do: <<128>>, else: <<0>>), size)
      assert byte_size(muted.data) == byte_size(buffer.data)

      for i <- 0..(frames - 1), reduce: true do
        ok ->
          # This frame spans this interval, in fractions of a nanosecond.
          begins = @s * rate - (frames - i) * @s
          ends = begins + @s
          silent? = from * rate < ends and begins < to * rate
          ok and binary_part(muted.data, i * size, size) == silence == silent?
      end
    end
  end

  test "an invalid span is rejected with an example" do
    for text <- ["", "5", "5-4", "a-b", "1-2-3", "1-1"] do
      error = assert_raise Situ.Error, fn -> Anonymise.parse_span!(text) end
      assert error.code == :bad_option and error.fix =~ "12.5-14"
    end
  end
end

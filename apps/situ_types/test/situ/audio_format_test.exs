defmodule Situ.AudioFormatTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.AudioFormat
  doctest Situ.AudioFormat

  property "converting frames to nanoseconds and back returns the same frame" do
    forall {rate, frames} <- {integer(1, 192_000), integer(0, 1_000_000)} do
      AudioFormat.ns_to_frames(rate, AudioFormat.frames_to_ns(rate, frames)) == frames
    end
  end

  test "every sample type has its own code" do
    for sample <- AudioFormat.sample_types() do
      assert AudioFormat.sample_from_code(AudioFormat.code(sample)) == {:ok, sample}
    end

    assert {:error, %{code: :bad_audio_format}} = AudioFormat.sample_from_code(0)
  end
end

defmodule Situ.AudioOps.ChannelsTest do
  use ExUnit.Case, async: true
  alias Situ.{AudioBuffer, AudioFormat, AudioOps}

  test "names the first sample that is not a number" do
    for {sample, good, bad} <- [
          {:f32, <<0.5::float-little-32>>, <<0, 0, 0xC0, 0x7F>>},
          {:f64, <<0.5::float-little-64>>, <<0, 0, 0, 0, 0, 0, 0xF0, 0x7F>>}
        ] do
      format = %AudioFormat{rate: 8000, channels: 1, sample: sample}
      buffer = %AudioBuffer{format: format, data: good <> good <> bad <> good}
      assert {:error, %{code: :bad_audio, what: what, why: why}} = AudioOps.level(buffer)
      assert what =~ "sample 2 is not a number" and why =~ "NaN"
    end
  end
end

defmodule Situ.Studio.Visualizers.SpectrogramTest do
  # Sends audio segments for the page's transform.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking
  alias Situ.{AudioBuffer, AudioFormat}

  @second 1_000_000_000

  # Two seconds of a ramp at 8 kHz, a second without messages, and another second.
  defp sound(session) do
    format = %AudioFormat{rate: 8_000, channels: 1, sample: :s16}

    for s <- [1, 2, 4] do
      data = for i <- 0..7_999, into: <<>>, do: <<rem(i, 1_000)::little-signed-16>>
      {s * @second, %AudioBuffer{format: format, data: data}}
    end
    |> then(&put(session, "sound", &1))
  end

  test "each segment has the samples of its time, and gaps have none" do
    session = session()
    sound(session)

    for {from, to} <- [{0, 4 * @second}, {@second + 1, @second + div(@second, 4)}] do
      frame = shown(session, "sound", "spectrogram", from, to)
      assert %{kind: 12, own: 8_000, rows: rows} = frame
      assert rows in 1..502
      assert byte_size(frame.payload) == rows * (8 + 512 * 4)
      <<times::binary-size(rows * 8), samples::binary>> = frame.payload

      for {<<t::little-float-64>>, k} <- Enum.with_index(for <<t::binary-8 <- times>>, do: t) do
        time = frame.base + round(t)
        refute time in (2 * @second + 1)..(3 * @second - 64_000_001)
        <<first::little-float-32>> = binary_part(samples, k * 512 * 4, 4)
        place = div(rem(time, @second) * 8_000, @second)
        silent? = time > 2 * @second and time < 3 * @second
        expected = if silent?, do: 0.0, else: rem(place, 1_000) / 32_768
        assert_in_delta first, expected, 2 / 32_768
      end
    end
  end

  test "reports a stream that is not audio" do
    assert %{kind: 8} = shown(session(), "level", "spectrogram", 0, @second)
  end
end

defmodule Situ.Studio.Visualizers.WaveformTest do
  # Draws a single channel, or all channels if the interval is too long.
  use ExUnit.Case, async: true

  import Situ.Studio.Asking
  alias Situ.{AudioBuffer, AudioFormat}

  @t0 1_000_000_000

  setup do
    session = session()
    data = :binary.copy(<<16_384::little-16, -8_192::little-signed-16>>, 500)
    buffer = %AudioBuffer{format: AudioFormat.pcm(1_000, 2), data: data}
    put(session, "mic", for(i <- 1..4, do: {@t0 + i * 500_000_000, buffer}))
    {:ok, session: session}
  end

  defp extremes(session, props, seconds \\ 2) do
    spec = %{"stream" => "mic", "viz" => "waveform", "props" => props}
    to = @t0 + seconds * 1_000_000_000
    series = [[1, Integer.to_string(@t0), Integer.to_string(to), 10_000_000]]

    {%{frames: [frame]}, _} = ask(session, %{"open" => [[1, spec]], "series" => series})
    {Enum.min(column(frame, 1)), Enum.max(column(frame, 2)), frame.flags}
  end

  test "draws all channels together, or one", %{session: session} do
    assert {-0.25, 0.5, _} = extremes(session, %{})
    assert extremes(session, %{"channel" => "1"}) == {0.5, 0.5, 0}
    assert extremes(session, %{"channel" => "2"}) == {-0.25, -0.25, 0}
  end

  test "draws all channels of a long interval, and reports it", %{session: session} do
    assert {-0.25, 0.5, flags} = extremes(session, %{"channel" => "2"}, 200)
    assert Bitwise.band(flags, 4) == 4
  end
end

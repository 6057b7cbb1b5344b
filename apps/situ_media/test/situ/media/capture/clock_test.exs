defmodule Situ.Media.Capture.ClockTest do
  use ExUnit.Case, async: true

  alias Situ.Media.Capture.Clock

  @ms 1_000_000
  @step 10_000_000 * 1_000_000_000

  # Takes frames as `{kind, time in ms, arrival in ms}` and returns for each its time in ms, `:wait` or `:jump`.
  defp place(frames, clock \\ Clock.new(nil)) do
    {placed, _} =
      Enum.map_reduce(frames, clock, fn {kind, out, now}, clock ->
        case Clock.place_frame(clock, kind, round(out * @ms), now * @ms) do
          {:ok, time, clock} -> {div(time, @ms), clock}
          {:wait, clock} -> {:wait, clock}
          {:jump, by, clock} -> {{:jump, div(by, @ms)}, clock}
        end
      end)

    placed
  end

  defp marked(ms), do: ms + div(@step, @ms)

  test "a fixed clock adds its offset" do
    assert place([{:video, -5, 0}, {:video, 7, 1}], Clock.new(3 * @ms)) == [-2, 10]
  end

  test "sets a sender's clock by the smallest delay of the first moments" do
    assert place([{:video, 50_000, 900}, {:audio, 50_100, 930}, {:video, 50_200, 1_250}]) ==
             [:wait, :wait, 1_030]
  end

  test "a clock that goes back restarts at the arrival time for both streams" do
    before = [{:video, 100, 1_000}, {:video, 500, 1_400}, {:audio, 510, 1_410}]
    assert place(before) == [:wait, 1_400, 1_410]

    # Eight seconds later video and audio restart; the audio is accepted with the clock of the video.
    again = [
      {:video, marked(20), 9_400},
      {:audio, marked(30), 9_405},
      {:video, marked(420), 9_800},
      {:audio, marked(430), 9_820}
    ]

    assert place(before ++ again) ==
             [:wait, 1_400, 1_410, {:jump, -480}, :wait, 9_795, 9_805]
  end

  test "a stream that continues with the old clock keeps it" do
    frames = [
      {:video, 0, 1_000},
      {:video, 400, 1_400},
      {:audio, 400, 1_400},
      {:video, marked(0), 5_000},
      {:video, marked(400), 5_400},
      {:audio, 4_000, 5_000}
    ]

    assert place(frames) == [:wait, 1_400, 1_400, {:jump, -400}, 5_400, 5_000]
  end

  test "two restarts of one stream before the first of the other are two clocks" do
    frames = [
      {:video, 0, 1_000},
      {:audio, 400, 1_400},
      {:video, 400, 1_400},
      {:video, marked(0), 10_000},
      {:video, marked(400), 10_400},
      {:audio, marked(90_000), 100_000}
    ]

    # The audio time is where the video clock expects it, so it belongs to that clock.
    assert List.last(place(frames)) == 100_000

    # Here it is a minute off, so it cannot belong to the same clock.
    other = List.replace_at(frames, 5, {:audio, marked(30_000), 100_000})
    assert {:jump, 29_600} == List.last(place(other))
  end

  test "a leap ahead is a jump; small steps ahead, as of a segment, and late frames are not" do
    start = [{:video, 0, 1_000}, {:video, 400, 1_400}]
    assert place(start ++ [{:video, 90_000, 1_440}]) == [:wait, 1_400, {:jump, 89_600}]
    burst = for i <- 1..50, do: {:video, 400 + 40 * i, 1_400 + i}
    assert place(start ++ burst) |> Enum.take(-2) == [3_360, 3_400]
    assert place(start ++ [{:video, 8_000, 9_000}]) == [:wait, 1_400, 9_000]
  end

  test "many restarts keep no history" do
    clock =
      Enum.reduce(0..200, Clock.new(nil), fn i, clock ->
        # Each restart goes back by a second and arrives ten seconds later.
        result = Clock.place_frame(clock, :video, i * (@step - 1_000 * @ms), i * 10_000 * @ms)
        assert elem(result, 0) == if(i == 0, do: :wait, else: :jump)
        elem(result, tuple_size(result) - 1)
      end)

    assert map_size(clock.epochs) == 1
  end
end

defmodule Situ.Infer.TrackerTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Infer.Tracker
  doctest Situ.Infer.Track.Kalman

  alias Situ.Infer.Track.Kalman
  alias Situ.Infer.Tracker
  alias Situ.Rect

  @frame 40_000_000

  defp rect(x, y, label \\ "car"), do: Rect.new!(x: x, y: y, width: 20, height: 20, label: label)

  # Every frame is a list of rectangles. Returns the ids that come out, frame by frame.
  defp track(frames, opts \\ []) do
    {out, _} =
      frames
      |> Enum.with_index()
      |> Enum.map_reduce(Tracker.new(opts), fn {rects, i}, tracker ->
        Tracker.update_tracks(tracker, i * @frame, rects)
      end)

    out
  end

  defp ids(frames, opts \\ []),
    do: frames |> track(opts) |> Enum.map(fn rects -> Enum.map(rects, & &1.id) end)

  test "a filter predicts the position of a hidden object, so it keeps its id" do
    frames = for i <- 0..29, do: if(i in 12..18, do: [], else: [rect(i * 6, 0)])
    assert ids(frames) |> Enum.concat() |> Enum.uniq() == [0]
    # Without a filter it gets a new id, because it has moved on by two widths.
    assert ids(frames, motion: :none) |> Enum.concat() |> Enum.uniq() == [0, 1]
  end

  test "two objects that cross keep their ids" do
    frames = for i <- 0..20, do: [rect(i * 10, i * 2), rect(200 - i * 10, 60 - i * 2)]
    [[a, b] | _] = track(frames)
    last = frames |> track() |> List.last()
    assert Enum.find(last, &(&1.id == a.id)).x > 100
    assert Enum.find(last, &(&1.id == b.id)).x < 100
  end

  test "gives new ids after a long absence or another label, and none before min_hits" do
    gone = [[rect(0, 0)]] ++ List.duplicate([], 20) ++ [[rect(0, 0)]]
    assert ids(gone) |> Enum.concat() == [0, 1]
    assert ids(List.duplicate([rect(0, 0)], 4), min_hits: 3) == [[], [], [0], [0]]
    other = [[rect(0, 0)], [rect(0, 0, "bus")]]
    assert ids(other) == [[0], [1]]
    assert ids(other, labels: :any) == [[0], [0]]
  end

  defp frames do
    point = {integer(0, 300), integer(0, 300)}
    list(list(map(point, fn {x, y} -> rect(x, y) end)))
  end

  property "outputs are inputs with unique ids that do not depend on the order" do
    forall {frames, motion} <- {frames(), one_of([:kalman, :none])} do
      frames = Enum.map(frames, &Enum.uniq/1)
      out = track(frames, motion: motion)
      bare = Enum.map(out, fn rects -> rects |> Enum.map(&%{&1 | id: nil}) |> Enum.sort() end)

      bare == Enum.map(frames, &Enum.sort/1) and
        Enum.all?(out, fn rects -> Enum.uniq_by(rects, & &1.id) == rects end) and
        track(Enum.map(frames, &Enum.reverse/1), motion: motion) == out
    end
  end

  property "distant objects that move slowly keep their ids" do
    forall {starts, velocities, motion} <-
             {list(integer(0, 20), 3), list(integer(-6, 6), 3), one_of([:kalman, :none])} do
      frames =
        for i <- 0..20 do
          for {{start, v}, lane} <- Enum.with_index(Enum.zip(starts, velocities)),
              do: rect(200 + start + i * v, lane * 100)
        end

      frames
      |> track(motion: motion)
      |> Enum.flat_map(fn rects -> Enum.map(rects, &{&1.y, &1.id}) end)
      |> Enum.uniq()
      |> length() == 3
    end
  end

  property "the filter finds any constant velocity, and its covariance stays valid" do
    forall {start, v, dt} <- {float(-100.0, 100.0), float(-50.0, 50.0), float(0.01, 0.2)} do
      k =
        Enum.reduce(1..100, Kalman.new(start, 1.0, 50.0), fn i, k ->
          k = k |> Kalman.predict(dt, 0.5) |> Kalman.correct(start + v * i * dt, 1.0)
          {a, b, c} = k.p
          true = a > 0 and c > 0 and a * c - b * b > 0
          k
        end)

      # A hundred corrections with any gain leave little of the initial error.
      abs(k.value - (start + v * 100 * dt)) < 1.0 + abs(v) * 0.1
    end
  end
end

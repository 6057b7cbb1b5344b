defmodule Situ.Media.Capture.StallWatchTest do
  use ExUnit.Case, async: true

  alias Situ.Media.Capture.StallWatch

  test "watches each stream separately" do
    watch = StallWatch.new([:video, :audio], 100, 0)
    assert StallWatch.find_stalls(watch, 100) == %{silent: [], stuck: []}
    watch = Enum.reduce(1..20, watch, &StallWatch.note_frame(&2, :audio, &1 * 10, &1 * 10))
    assert StallWatch.find_stalls(watch, 201) == %{silent: [:video], stuck: []}
    watch = StallWatch.note_frame(watch, :video, 190, 202)
    assert StallWatch.find_stalls(watch, 203) == %{silent: [], stuck: []}
  end

  test "unmoving times count as stuck; a late stream and one waiting for its clock do not" do
    stuck =
      Enum.reduce(
        1..30,
        StallWatch.new([:video], 100, 0),
        &StallWatch.note_frame(&2, :video, 7 + div(&1, 10), &1 * 10)
      )

    assert StallWatch.find_stalls(stuck, 300) == %{silent: [], stuck: [:video]}

    late =
      Enum.reduce(
        1..30,
        StallWatch.new([:video], 100, 0),
        &StallWatch.note_frame(&2, :video, &1 * 10 - 9_000, &1 * 10)
      )

    assert StallWatch.find_stalls(late, 300) == %{silent: [], stuck: []}

    waiting =
      Enum.reduce(
        1..30,
        StallWatch.new([:video], 100, 0),
        &StallWatch.note_frame(&2, :video, nil, &1 * 10)
      )

    assert StallWatch.find_stalls(waiting, 300) == %{silent: [], stuck: []}
  end
end

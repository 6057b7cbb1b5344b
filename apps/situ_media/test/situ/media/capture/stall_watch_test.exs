defmodule Situ.Media.Capture.StallWatchTest do
  use ExUnit.Case, async: true

  alias Situ.Media.Capture.StallWatch

  test "each stream is watched by itself" do
    watch = StallWatch.new([:video, :audio], 100, 0)
    assert StallWatch.check(watch, 100) == %{silent: [], stuck: []}
    watch = Enum.reduce(1..20, watch, &StallWatch.note(&2, :audio, &1 * 10, &1 * 10))
    assert StallWatch.check(watch, 201) == %{silent: [:video], stuck: []}
    watch = StallWatch.note(watch, :video, 190, 202)
    assert StallWatch.check(watch, 203) == %{silent: [], stuck: []}
  end

  test "frames whose times do not move are no progress; a late stream is, and one that waits for its clock" do
    stuck =
      Enum.reduce(
        1..30,
        StallWatch.new([:video], 100, 0),
        &StallWatch.note(&2, :video, 7 + div(&1, 10), &1 * 10)
      )

    assert StallWatch.check(stuck, 300) == %{silent: [], stuck: [:video]}

    late =
      Enum.reduce(
        1..30,
        StallWatch.new([:video], 100, 0),
        &StallWatch.note(&2, :video, &1 * 10 - 9_000, &1 * 10)
      )

    assert StallWatch.check(late, 300) == %{silent: [], stuck: []}

    waiting =
      Enum.reduce(
        1..30,
        StallWatch.new([:video], 100, 0),
        &StallWatch.note(&2, :video, nil, &1 * 10)
      )

    assert StallWatch.check(waiting, 300) == %{silent: [], stuck: []}
  end
end

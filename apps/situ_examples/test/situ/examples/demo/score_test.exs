defmodule Situ.Examples.Demo.ScoreTest do
  use ExUnit.Case, async: true

  alias Situ.Examples.Demo.{Score, GroundTruth}
  alias Situ.Rect

  # Ten images a second; the single face speaks from 1 to 3 s.
  @json ~s({"fps": 10, "frames": 50, "faces": [{"id": 0, "box": [0, 0, 9, 9]}],
    "speech": [{"face": 0, "speech_start": 1.0, "speech_end": 3.0}]})

  defp truth do
    {:ok, truth} = GroundTruth.parse(@json)
    truth
  end

  defp found(frames),
    do: for(i <- frames, do: {i * 100_000_000, [{Rect.new!(1, 1, 9, 9), i in 10..29}]})

  test "an image counts until the next one, so dropped images are not silence" do
    whole = Score.score_decisions(truth(), found(0..49))
    assert {whole.frame_accuracy, whole.missed_speech_s} == {1.0, 0.0}

    # Only every third image, and a still image for 0.9 s.
    thinned = Enum.reject(0..49, &(rem(&1, 3) == 1 or &1 in 15..23)) |> found()
    score = Score.score_decisions(truth(), thinned)
    assert {score.frame_accuracy, score.missed_speech_s} == {1.0, 0.0}
    assert score.scored_frames == whole.scored_frames
  end

  test "an image without a decision is silence, and so is the time after the last image" do
    undecided =
      for {time, faces} <- found(0..49),
          do: {time, if(time == 2_000_000_000, do: [], else: faces)}

    assert Score.score_decisions(truth(), undecided).missed_speech_s == 0.1
    assert Score.score_decisions(truth(), found(0..19)).missed_speech_s == 0.9
    assert Score.score_decisions(truth(), []).missed_speech_s == 1.6
    # Images after the end of the truth, or more images than it has, do no harm.
    assert Score.score_decisions(truth(), found(0..80)).frame_accuracy == 1.0
    twice = for i <- 0..98, do: {i * 50_000_000, [{Rect.new!(1, 1, 9, 9), i in 20..59}]}
    assert Score.score_decisions(truth(), twice).frame_accuracy == 1.0
  end
end

defmodule Situ.Examples.Demo.TranscriptTest do
  use ExUnit.Case, async: true
  alias Situ.Examples.Demo.{Transcript, GroundTruth}
  alias Situ.Infer.Speech.Utterance
  alias Situ.Rect
  doctest Situ.Examples.Demo.Transcript

  @json ~s({"fps": 25, "frames": 100, "faces": [{"id": 7, "box": [0, 0, 9, 9]}],
    "speech": [{"face": 7, "speech_start": 0, "speech_end": 1, "text": "go on"},
               {"face": null, "speech_start": 2, "speech_end": 3, "text": "stop it"}]})

  defp said(text, from, to), do: %Utterance{text: text, from: from, to: to, confidence: 1.0}

  test "assigns an utterance to the face that spoke most, and scores words and faces" do
    {:ok, truth} = GroundTruth.parse(@json)
    speaker = Rect.new!(x: 0, y: 0, width: 9, height: 9, id: 0)
    other = %{speaker | x: 50, id: 1}
    found = for i <- 0..99, do: {i * 40_000_000, [{speaker, i < 25}, {other, i in 20..24}]}

    lines =
      Transcript.attribute_utterances(
        [said("Go on!", 0, 1_000_000_000), said("Stop", 2_000_000_000, 3_000_000_000)],
        found
      )

    assert [%{face: 0, text: "Go on!"}, %{face: nil}] = lines
    assert Transcript.score_lines(lines, truth) == %{wer: 0.25, right_face: 1.0}
    assert Transcript.score_lines([], truth) == %{wer: 1.0, right_face: 0.0}
    assert Transcript.score_lines(lines, %{truth | said: []}) == %{wer: nil, right_face: nil}
  end

  test "text that looks like markup remains text" do
    line = %{face: nil, rect: nil, from: 3_723_004_000_000, to: 3_724_000_000_000, text: "<b>&"}

    assert IO.iodata_to_binary(Transcript.to_webvtt([line])) ==
             "WEBVTT\n\n01:02:03.004 --> 01:02:04.000\n<v outside>&lt;b&gt;&amp;\n"
  end
end

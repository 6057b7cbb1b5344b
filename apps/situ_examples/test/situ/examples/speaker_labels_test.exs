defmodule Situ.Examples.SpeakerLabelsTest do
  use ExUnit.Case, async: true
  alias Situ.Examples.SpeakerLabels
  alias Situ.Infer.Mouth
  alias Situ.Infer.Speech.Utterance
  doctest Situ.Examples.SpeakerLabels

  @ms 1_000_000

  defp picture(ms, speaker) do
    mouth = fn id ->
      rect = Situ.Rect.new!(x: 100 * id, y: 0, width: 50, height: 50, id: id)
      %Mouth{opening: 0.1, baseline: 0.1, open?: false, time: ms * @ms, rect: rect}
    end

    {ms * @ms, {Map.new([0, 1], &{&1, mouth.(&1)}), Map.new([0, 1], &{&1, &1 == speaker})}}
  end

  defp said(text, from, to) do
    {to * @ms, %Utterance{text: text, from: from * @ms, to: to * @ms, confidence: 1.0}}
  end

  test "draws words at the face that speaks them, and none for an off-screen voice" do
    pictures = for ms <- 0..2_000//40, do: picture(ms, if(ms in 200..800, do: 1))
    utterances = [said("Go forward ten meters.", 200, 800), said("Stop.", 1_200, 1_600)]

    out =
      Situ.to_list(
        fn p ->
          inputs = [
            faces: Situ.from_enumerable(p, pictures),
            said: Situ.from_enumerable(p, utterances)
          ]

          Situ.via(inputs, SpeakerLabels)
        end,
        times: true
      )

    assert for({time, [rect]} <- out, uniq: true, do: {rect.id, rect.label, time >= 200 * @ms}) ==
             [{1, "Go forward ten meters.", true}]

    assert Enum.map(out, &div(elem(&1, 0), @ms)) ==
             Enum.to_list(200..800//40) ++ Enum.to_list(1_200..1_600//40)

    assert Enum.all?(out, fn {time, boxes} -> time < 1_000 * @ms or boxes == [] end)
  end
end

defmodule Situ.Infer.SpeechSynthesizerTest do
  use ExUnit.Case, async: true
  alias Situ.{AudioBuffer, AudioFormat}
  alias Situ.Infer.Speech.{Moonshine, Utterance}
  alias Situ.Infer.SpeechSynthesizer

  defp say(texts, opts \\ []) do
    Situ.to_list(
      fn p -> p |> Situ.from_enumerable(texts) |> Situ.via(SpeechSynthesizer, opts) end,
      times: true
    )
  end

  test "sounds follow each other, each at its end, and a text said again sounds the same" do
    assert [{t1, one}, {t2, two}, {t3, three}] =
             say([{0, "hello"}, {1, ""}, {2, "good bye"}, {9_000_000_000, "hello"}])

    assert one.format == AudioFormat.pcm(16_000) and AudioBuffer.frames(one) > 4_000
    assert t1 == AudioBuffer.duration(one)
    assert t2 == t1 + AudioBuffer.duration(two)
    assert t3 == 9_000_000_000 + AudioBuffer.duration(three)
    assert three == one and two != one
  end

  test "text is only text, whatever it looks like" do
    assert [{_, sound}] = say([{0, "--help; $(touch /tmp/x) `id` -v de"}])
    assert AudioBuffer.frames(sound) > 8_000
  end

  test "an unknown voice stops the pipeline and says how to find another" do
    assert_raise Situ.Error, ~r/espeak-ng --voices/, fn ->
      say([{0, "hello"}], synthesizer_options: [voice: "nobody"])
    end
  end

  test "bytes that are no text are an error" do
    for text <- [<<255>>, "a\0b", String.duplicate("word ", 30_000)] do
      assert_raise Situ.Error, ~r/cannot be spoken/, fn -> say([{0, text}]) end
    end
  end

  @tag :moonshine
  test "the recogniser understands 80 % of the words" do
    texts = [
      "Please open the window, it is warm in here.",
      "The train leaves at nine in the morning.",
      "We go to the park with the children."
    ]

    sounds = texts |> Enum.with_index(&{&2, &1}) |> say()
    {:ok, moonshine} = Moonshine.load()

    heard =
      for {_, sound} <- sounds do
        {:ok, %{text: text}} = Moonshine.transcribe(moonshine, sound)
        text
      end

    rate = Utterance.error_rate(Enum.join(texts, " "), Enum.join(heard, " "))
    assert rate <= 0.2, "#{rate}: #{inspect(heard)}"
  end
end

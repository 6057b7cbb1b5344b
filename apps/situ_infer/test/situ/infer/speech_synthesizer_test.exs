defmodule Situ.Infer.SpeechSynthesizerTest do
  use ExUnit.Case, async: true
  alias Situ.{AudioBuffer, AudioFormat}
  alias Situ.Infer.Speech.{Moonshine, Utterance}
  alias Situ.Infer.SpeechSynthesizer

  defp say(texts, opts \\ []) do
    Situ.to_list(
      fn p ->
        p |> Situ.from_enumerable(texts) |> Situ.via(SpeechSynthesizer, opts) |> Map.fetch!(:out)
      end,
      times: true
    )
  end

  test "utterances follow each other, and repeated text sounds the same" do
    assert [{t1, one}, {t2, two}, {t3, three}] =
             say([{0, "hello"}, {1, ""}, {2, "good bye"}, {9_000_000_000, "hello"}])

    assert one.format == AudioFormat.pcm(16_000) and AudioBuffer.frame_count(one) > 4_000
    assert t1 == AudioBuffer.duration_ns(one)
    assert t2 == t1 + AudioBuffer.duration_ns(two)
    assert t3 == 9_000_000_000 + AudioBuffer.duration_ns(three)
    assert three == one and two != one
  end

  test "reports the times of words and sounds, also for cached text" do
    texts = [
      {0, "Go forward ten meters."},
      {1, "Stop."},
      {9_000_000_000, "Go forward ten meters."}
    ]

    [words, phonemes, sounds] =
      Situ.to_list(
        fn p ->
          spoken = p |> Situ.from_enumerable(texts) |> Situ.via(SpeechSynthesizer, marks: true)
          [spoken.words, spoken.phonemes, spoken.out]
        end,
        times: true
      )

    assert Enum.map(words, fn {_, mark} -> mark.text end) ==
             ~w(Go forward ten meters Stop Go forward ten meters)

    for {time, mark} <- words, do: assert(time == mark.from and mark.to > mark.from)
    [{first, _}, {second, _}, {_, _}] = sounds
    {_, stop} = Enum.at(words, 4)
    assert stop.from >= first and stop.to <= second
    assert {_, %{from: from}} = Enum.at(words, 5)
    assert from - 9_000_000_000 == words |> hd() |> elem(1) |> Map.fetch!(:from)
    assert Enum.map_join(Enum.take(phonemes, 3), fn {_, mark} -> mark.text end) == "ɡoʊf"
    times = Enum.map(phonemes, &elem(&1, 0))
    assert times == Enum.sort(Enum.uniq(times))
  end

  defmodule Dumb do
    @behaviour Situ.Infer.Speech.Synthesizer
    @impl true
    def load(_), do: {:ok, nil}
    @impl true
    def speak(_, _), do: AudioBuffer.new(format: AudioFormat.pcm(16_000), data: "")
  end

  test "unsupported marks are an error immediately" do
    assert_raise Situ.Error, ~r/Dumb does not support the times of words/, fn ->
      say([{0, "hello"}], synthesizer: Dumb, marks: true)
    end

    assert_raise Situ.Error, ~r/marks: cannot be combined with stamp/, fn ->
      say([{0, "hello"}], marks: true, stamp: :text)
    end
  end

  test "treats text as text, whatever it looks like" do
    assert [{_, sound}] = say([{0, "--help; $(touch /tmp/x) `id` -v de"}])
    assert AudioBuffer.frame_count(sound) > 8_000
  end

  test "an unknown voice stops the pipeline and says how to find another" do
    assert_raise Situ.Error, ~r/espeak-ng --voices/, fn ->
      say([{0, "hello"}], synthesizer_options: [voice: "nobody"])
    end
  end

  test "bytes that are not text are an error" do
    for text <- [<<255>>, "a\0b", String.duplicate("word ", 30_000)] do
      assert_raise Situ.Error, ~r/cannot be spoken/, fn -> say([{0, text}]) end
    end
  end

  @tag :moonshine
  test "the recognizer understands 80 % of the words" do
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

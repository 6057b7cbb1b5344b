defmodule Situ.Infer.Speech.WakeWordTest do
  use ExUnit.Case, async: true
  alias Situ.{AudioBuffer, AudioFormat, AudioOps}
  alias Situ.Infer.Speech.Espeak
  alias Situ.Infer.Speech.WakeWord.{KeywordSpotter, TranscriptSpotter}
  doctest Situ.Infer.Speech.WakeWord.TranscriptSpotter

  defp sentences(texts) do
    {:ok, voice} = Espeak.load(rate: 140)
    pause = AudioBuffer.build_silence(AudioFormat.pcm(16_000), 16_000)

    sounds =
      for text <- texts do
        {:ok, sound} = Espeak.speak(voice, text)

        [
          pause,
          sound |> AudioOps.reformat!(channels: 1, sample: :s16) |> AudioOps.resample!(16_000)
        ]
      end

    {:ok, whole} = AudioBuffer.concat(List.flatten(sounds) ++ [pause])
    whole
  end

  defp heard(sound, opts) do
    feed =
      for from <- 0..(AudioBuffer.frame_count(sound) - 1)//320 do
        part = AudioBuffer.slice_frames(sound, from, 320)
        {AudioFormat.frames_to_ns(sound.format, from + AudioBuffer.frame_count(part)), part}
      end

    Situ.to_list(fn p -> p |> Situ.from_enumerable(feed) |> Situ.Infer.wake_word(opts) end)
  end

  @texts ["The weather is fine today.", "Hey computer, what time is it?", "We had a good dinner."]

  @tag :moonshine
  test "finds a name among recognized words, once, in the sentence that contains it" do
    sound = sentences(@texts)
    assert [%{text: "computer", confidence: p} = called] = heard(sound, phrase: "computer")
    assert p > 0.5
    length = AudioBuffer.duration_ns(sound)
    assert called.from > length / 4 and called.to < length * 3 / 4
    assert heard(sentences(["The weather is fine today."]), phrase: "computer") == []
  end

  if System.find_executable("pocketsphinx_continuous") do
    test "finds a name by its sound in a real voice, and not in other speech" do
      opts = [phrase: "Forward", spotter: KeywordSpotter]
      {:ok, sound} = Situ.Media.Wav.read(Path.expand("../../../fixtures/goforward.wav", __DIR__))
      pause = AudioBuffer.build_silence(sound.format, 16_000)
      {:ok, whole} = AudioBuffer.concat([pause, sound, pause])
      assert [%{text: "Forward", words: [word], confidence: p}] = heard(whole, opts)
      # The word begins 0.64 s into the recording.
      assert_in_delta word.from, 1_640_000_000, 150_000_000
      assert p > 0.5
      assert heard(sentences(["The weather is fine today."]), opts) == []
    end
  end

  test "a phrase without words is an error" do
    assert {:error, %{code: :bad_option}} = TranscriptSpotter.load(phrase: "...")
    assert {:error, %{code: :missing_option}} = TranscriptSpotter.load([])
  end
end

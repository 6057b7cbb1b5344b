defmodule Situ.Infer.SpeechHearingTest do
  # Tests speech recognition end to end with realistic audio.
  use ExUnit.Case, async: true
  alias Situ.{AudioBuffer, AudioFormat, AudioOps}
  alias Situ.Infer.Speech.Utterance

  @moduletag :moonshine
  @fixtures Path.expand("../../fixtures", __DIR__)
  @pcm AudioFormat.pcm(16_000)

  defp wav(name) do
    {:ok, sound} = Situ.Media.Wav.read(Path.join(@fixtures, name))
    sound
  end

  # In buffers of 20 ms, as from a device, with one second of silence before and after.
  defp hear(sound) do
    format = sound.format
    silence = AudioBuffer.build_silence(format, format.rate)
    {:ok, whole} = AudioBuffer.concat([silence, sound, silence])
    step = div(format.rate, 50)

    feed =
      for from <- 0..(AudioBuffer.frame_count(whole) - 1)//step do
        part = AudioBuffer.slice_frames(whole, from, step)
        {AudioFormat.frames_to_ns(format, from + AudioBuffer.frame_count(part)), part}
      end

    Situ.to_list(fn p ->
      p
      |> Situ.from_enumerable(feed)
      |> Situ.AudioStream.to_mono()
      |> Situ.AudioStream.resample(16_000)
      |> Situ.Infer.transcribe()
    end)
  end

  defp text(sound), do: sound |> hear() |> Enum.map_join(" ", & &1.text)

  defp made(seconds, fun) do
    samples = for n <- 0..(seconds * 16_000 - 1), do: fun.(n / 16_000)
    AudioBuffer.from_samples(samples, @pcm)
  end

  test "silence, noise and music give no words" do
    :rand.seed(:exsss, 7)
    assert hear(AudioBuffer.build_silence(@pcm, 4 * 16_000)) == []
    assert hear(made(4, fn _ -> round(:rand.normal() * 2_000) end)) == []

    # Chords of three notes, struck every half second.
    chord = fn t ->
      root = Enum.at([220.0, 261.6, 196.0, 246.9], rem(trunc(t * 2), 4))
      fade = :math.exp(-3 * (t * 2 - trunc(t * 2)))

      for(k <- [1, 1.25, 1.5], do: :math.sin(2 * :math.pi() * root * k * t))
      |> Enum.sum()
      |> Kernel.*(4_000 * fade)
      |> round()
    end

    assert hear(made(6, chord)) == []
  end

  test "recognizes words in noise, 48 kHz stereo, 8 kHz telephone and overdriven audio" do
    sound = wav("goforward.wav")
    :rand.seed(:exsss, 8)

    noisy =
      sound
      |> AudioBuffer.to_samples()
      |> Enum.map(&(&1 + round(:rand.normal() * 100)))
      |> AudioBuffer.from_samples(@pcm)

    versions = [
      noisy: noisy,
      stereo: sound |> AudioOps.resample!(48_000) |> AudioOps.reformat!(channels: 2),
      telephone: AudioOps.resample!(sound, 8_000),
      clipped: AudioOps.gain!(sound, 8)
    ]

    for {name, version} <- versions do
      heard = text(version)
      rate = Utterance.error_rate("go forward ten meters", heard)
      assert rate <= 0.25, "#{name}: #{inspect(heard)}"
    end
  end

  test "audio that was not resampled stops the pipeline and suggests a fix" do
    sound = AudioOps.resample!(wav("goforward.wav"), 48_000)

    assert_raise Situ.Error, ~r/Situ.AudioStream.resample\(16_000\)/, fn ->
      Situ.to_list(fn p ->
        p |> Situ.from_enumerable([sound], every: 1) |> Situ.Infer.transcribe()
      end)
    end
  end
end

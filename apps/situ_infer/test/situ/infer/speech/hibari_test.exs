defmodule Situ.Infer.Speech.HibariTest do
  use ExUnit.Case, async: true
  alias Situ.{AudioBuffer, AudioOps, Tensor}
  alias Situ.Infer.Speech.{Hibari, Moonshine, Utterance}
  alias Situ.Infer.Speech.Hibari.{Phonemes, Vocoder}
  doctest Situ.Infer.Speech.Hibari.Phonemes

  test "converts text to phonetic symbols by sentence, keeping punctuation" do
    assert {:ok, ["həlˈO ðˈɛɹ!", "ɡˌO ˈɔn, plˈiz."]} =
             Phonemes.sentence_phonemes("Hello there! Go on, please.")

    assert {:ok, []} = Phonemes.sentence_phonemes(" ...\n\n ")
    # Text that looks like an option or a command is treated as text.
    assert {:ok, [signs]} = Phonemes.sentence_phonemes("--help $(id)")
    assert signs =~ "hˈɛlp"
  end

  test "pulses have the requested pitch, and none below the range of a voice" do
    f0 = Tensor.from_list(List.duplicate(200.0, 20) ++ List.duplicate(0.0, 20), :f32, {1, 40})
    pulses = for <<x::float-native-32 <- Vocoder.pulse_train(f0)>>, do: x
    assert length(pulses) == 40 * 300
    {voiced, silent} = Enum.split(pulses, 20 * 300)
    # 200 Hz at 24 kHz is a pulse every 120 samples, so 50 of them in 6,000.
    peaks =
      voiced
      |> Enum.chunk_every(3, 1, :discard)
      |> Enum.count(fn [a, b, c] -> b > 40 and b >= a and b > c end)

    assert_in_delta peaks, 50, 2
    assert Enum.all?(Enum.drop(silent, 300), &(&1 == 0.0))
  end

  test "a spectrum of only a pitch gives audio of that pitch" do
    {:ok, vocoder} = Vocoder.load()
    frames = 40

    flat = fn value ->
      Tensor.from_list(List.duplicate(value, 601 * frames), :f32, {1, 601, frames})
    end

    spectrum = %{
      "f0" => Tensor.from_list(List.duplicate(250.0, frames), :f32, {1, frames}),
      "lh" => flat.(-4.0),
      "theta" => flat.(0.0),
      "ln" => flat.(-30.0),
      "lr" => flat.(-30.0),
      "phi" => flat.(0.0)
    }

    {:ok, floats} = Vocoder.synthesize_audio(vocoder, spectrum)
    samples = for <<x::float-native-32 <- floats>>, do: x
    assert length(samples) == frames * 300
    middle = Enum.slice(samples, 3_000, 4_800)
    # It repeats after 96 samples, the period of 250 Hz, and not after 60.
    assert likeness(middle, 96) > 0.98
    assert likeness(middle, 60) < 0.5
    # The pulses pass unchanged except for their strength, so the inverse transform is correct.
    pulses = for <<x::float-native-32 <- Vocoder.pulse_train(spectrum["f0"])>>, do: x
    strength = :math.exp(-4.0) / 300

    for {x, pulse} <- Enum.zip(middle, Enum.slice(pulses, 3_000, 4_800)),
        do: assert_in_delta(x, pulse * strength, 2.0e-3)

    assert {:error, %{code: :synthesis_failed}} =
             Vocoder.synthesize_audio(vocoder, %{"f0" => Tensor.from_list([1.0], :f32, {1, 1})})
  end

  defp likeness(samples, lag) do
    pairs = Enum.zip(samples, Enum.drop(samples, lag))
    power = for {a, _} <- pairs, reduce: 0.0, do: (sum -> sum + a * a)
    (for({a, b} <- pairs, do: a * b) |> Enum.sum()) / power
  end

  @tag :tmp_dir
  test "an invalid model folder is an error", %{tmp_dir: dir} do
    assert {:error, _} = Hibari.load(folder: dir)
    File.write!(Path.join(dir, "vocab.json"), "[1]")
    assert {:error, %{code: :bad_model}} = Hibari.load(folder: dir)
    File.write!(Path.join(dir, "vocab.json"), ~s({"a": 1}))
    assert {:error, %{code: :no_model_file}} = Hibari.load(folder: dir)
    File.write!(Path.join(dir, "hibari.onnx"), "no model")
    assert {:error, %{code: :bad_model}} = Hibari.load(folder: dir)
    assert {:error, %{code: :bad_option}} = Hibari.load(speed: 9.0)
  end

  describe "with the model" do
    @describetag :hibari

    test "the same text sounds the same, faster is shorter, and empty text is empty" do
      {:ok, voice} = Hibari.load()
      {:ok, sound} = Hibari.speak(voice, "Go forward ten meters.")
      assert {:ok, ^sound} = Hibari.speak(voice, "Go forward ten meters.")
      assert sound.format.rate == 24_000
      assert {:ok, %{peak: peak}} = AudioOps.level(sound)
      assert peak > 0.05 and peak < 1.0
      {:ok, quick} = Hibari.load(speed: 1.5)
      {:ok, short} = Hibari.speak(quick, "Go forward ten meters.")
      assert AudioBuffer.duration_ns(short) < 0.8 * AudioBuffer.duration_ns(sound)
      assert {:ok, %{data: ""}} = Hibari.speak(voice, " ... ")
      assert {:error, %{code: :bad_text}} = Hibari.speak(voice, <<255>>)
    end

    @tag :moonshine
    test "the recognizer understands 80 % of the words" do
      {:ok, voice} = Hibari.load()
      {:ok, moonshine} = Moonshine.load()

      texts = [
        "Please open the window, it is warm in here.",
        "The train leaves at nine in the morning.",
        "Your timer of five minutes is over."
      ]

      heard =
        for text <- texts do
          {:ok, sound} = Hibari.speak(voice, text)
          {:ok, %{text: text}} = Moonshine.transcribe(moonshine, sound)
          text
        end

      rate = Utterance.error_rate(Enum.join(texts, " "), Enum.join(heard, " "))
      assert rate <= 0.2, "#{rate}: #{inspect(heard)}"
    end
  end
end

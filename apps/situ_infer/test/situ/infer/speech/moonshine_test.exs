defmodule Situ.Infer.Speech.MoonshineTest do
  use ExUnit.Case, async: true
  alias Situ.{AudioBuffer, AudioFormat, AudioOps}
  alias Situ.Infer.Speech.{Moonshine, Utterance}

  @fixtures Path.expand("../../../fixtures", __DIR__)

  defp wav(name) do
    {:ok, buffer} = Situ.Media.Wav.read(Path.join(@fixtures, name))
    buffer
  end

  @tag :tmp_dir
  test "an invalid model folder is an error", %{tmp_dir: dir} do
    assert {:error, %{code: :bad_model}} = Moonshine.load(folder: dir)
    File.write!(Path.join(dir, "tokenizer.bin"), <<200, 200, 1>>)
    assert {:error, %{code: :bad_model}} = Moonshine.load(folder: dir)
    File.write!(Path.join(dir, "tokenizer.bin"), <<1, "a">>)
    assert {:error, %{code: :no_model_file}} = Moonshine.load(folder: dir)
    File.write!(Path.join(dir, "encoder_model.ort"), "no model")
    assert {:error, %{code: :bad_model}} = Moonshine.load(folder: dir)
  end

  describe "with the model" do
    @describetag :moonshine

    test "recognizes the recordings with 6 % of read words and 12 % of commands wrong" do
      {:ok, moonshine} = Moonshine.load()

      {:ok, truth} =
        @fixtures |> Path.join("transcripts.json") |> File.read!() |> Situ.JSON.decode()

      for {files, limit} <- [
            {~w(sense_and_sensibility_01_austen_64kb-0870 sense_and_sensibility_01_austen_64kb-0880
                sense_and_sensibility_01_austen_64kb-0930), 0.06},
            {~w(cards_001 cards_002 cards_004 goforward), 0.12}
          ] do
        {said, heard} =
          Enum.unzip(
            for file <- files do
              {:ok, %{text: text, confidence: p}} =
                Moonshine.transcribe(moonshine, wav(file <> ".wav"))

              assert p > 0.5 and p <= 1.0
              {truth[file <> ".wav"]["text"], text}
            end
          )

        rate = Utterance.error_rate(Enum.join(said, " "), Enum.join(heard, " "))
        assert rate <= limit, "#{rate}: #{inspect(heard)}"
      end
    end

    test "returns alternatives" do
      {:ok, moonshine} = Moonshine.load(alternatives: 3)
      {:ok, plain} = Moonshine.load()
      sound = wav("cards_002.wav")
      {:ok, %{text: text, confidence: best} = heard} = Moonshine.transcribe(moonshine, sound)

      assert {:ok, %{text: ^text, confidence: ^best, alternatives: []}} =
               Moonshine.transcribe(plain, sound)

      assert [%{text: other, confidence: next} | _] = heard.alternatives
      assert other != text and next <= best
      assert heard.alternatives == Enum.sort_by(heard.alternatives, &(-&1.confidence))
      # "clubs" is heard as "gloves" or "cloves", but the correct word is among the alternatives.
      assert Enum.any?([heard | heard.alternatives], &(&1.text =~ ~r/queen of/i))
    end

    test "accepts other rates and channels; short audio gives no text, long audio an error" do
      {:ok, moonshine} = Moonshine.load()

      sound =
        wav("goforward.wav") |> AudioOps.resample!(48_000) |> AudioOps.reformat!(channels: 2)

      assert {:ok, %{text: text}} = Moonshine.transcribe(moonshine, sound)
      assert Utterance.error_rate("go forward ten meters", text) == 0.0
      silence = &AudioBuffer.build_silence(AudioFormat.pcm(16_000), &1)
      assert {:ok, %{text: ""}} = Moonshine.transcribe(moonshine, silence.(100))
      assert {:error, %{code: :too_long}} = Moonshine.transcribe(moonshine, silence.(65 * 16_000))
    end
  end
end

defmodule Situ.Infer.Speech.PocketSphinxTest do
  # A person's voice (PocketSphinx's own test data, BSD): cards.
  use ExUnit.Case, async: true

  alias Situ.Infer.Speech.{PocketSphinx, Utterance}
  alias Situ.Infer.SpeechRecognizer
  alias Situ.Media.Wav

  @clip Path.expand("../../../../../situ_media/test/fixtures/cards_001.wav", __DIR__)
  @cards """
  #JSGF V1.0;
  grammar cards;
  public <cards> = <card>+;
  <card> = (ace | two | three | four | five | six | seven | eight | nine | ten | jack | queen | king) of
           (clubs | diamonds | hearts | spades);
  """
  @other "#JSGF V1.0; grammar other; public <other> = good morning | good night;"

  if !System.find_executable("pocketsphinx_continuous"),
    do:
      @moduletag(skip: "not here: pocketsphinx (apt-get install pocketsphinx pocketsphinx-en-us)")

  test "it hears what the grammar allows, and another grammar while it runs" do
    {:ok, sound} = Wav.read(@clip)
    {:ok, sphinx} = PocketSphinx.load(grammar: @cards)
    assert {:ok, %{text: text, confidence: 0.5}} = PocketSphinx.transcribe(sphinx, sound)
    assert Enum.all?(Utterance.words(text), &String.contains?(@cards, &1)) and text =~ " of "

    opts = [recognizer: PocketSphinx, recognizer_options: [grammar: @cards], partial: nil]

    test =
      Situ.Test.start([:sound, :speaking, :options], fn s ->
        Situ.via(Map.to_list(s), SpeechRecognizer, opts).out
      end)

    s = 1_000_000_000
    Situ.Test.advance(test, 60 * s)
    length = Situ.AudioBuffer.duration(sound)

    heard = fn at ->
      speaking = for t <- (at - length + 1)..(at - 300_000_000)//100_000_000, do: {t, true}
      Situ.Test.feed(test, :sound, [{at, sound}])
      Situ.Test.feed(test, :speaking, speaking ++ [{at - 150_000_000, false}])
    end

    heard.(10 * s)
    Situ.Test.feed(test, :options, [{15 * s, [grammar: @other]}])
    heard.(30 * s)
    Situ.Test.close(test, :sound)
    Situ.Test.close(test, :speaking)
    said = for {_, utterance} <- Situ.Test.outputs(test), do: utterance.text
    assert [first | rest] = said
    assert first =~ " of "
    assert Enum.all?(rest, &(&1 =~ "good"))
    Situ.Test.stop(test)
  end

  test "silence is nothing, and a grammar that is none is an error" do
    {:ok, sphinx} = PocketSphinx.load(grammar: @cards)

    silence =
      Situ.AudioBuffer.new!(
        format: Situ.AudioFormat.pcm(16_000),
        data: <<0::size(16_000)-unit(16)>>
      )

    assert {:ok, %{text: "", confidence: 0.0}} = PocketSphinx.transcribe(sphinx, silence)
    assert {:error, %{code: :bad_grammar}} = PocketSphinx.load(grammar: "#JSGF")
    assert {:error, %{code: :no_grammar}} = PocketSphinx.load(grammar: "/nowhere")
  end
end

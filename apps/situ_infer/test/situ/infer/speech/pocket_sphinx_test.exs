defmodule Situ.Infer.Speech.PocketSphinxTest do
  # A real voice from PocketSphinx's own test data (BSD license): card names.
  use ExUnit.Case, async: true
  doctest Situ.Infer.Speech.PocketSphinx.OutputParser

  alias Situ.Infer.Speech.PocketSphinx
  alias Situ.Infer.SpeechRecognizer
  alias Situ.Media.Wav

  @clip Path.expand("../../../../../situ_media/test/fixtures/cards_001.wav", __DIR__)
  @fixtures Path.expand("../../../fixtures", __DIR__)
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

  test "recognizes sentences of the grammar, and accepts another grammar while running" do
    {:ok, sound} = Wav.read(@clip)
    {:ok, sphinx} = PocketSphinx.load(grammar: @cards)
    assert {:ok, %{text: "ten of clubs"} = heard} = PocketSphinx.transcribe(sphinx, sound)
    assert heard.confidence > 0.7
    assert Enum.map(heard.words, & &1.text) == ["ten", "of", "clubs"]

    assert Enum.all?(
             heard.words,
             &(&1.from < &1.to and &1.to <= Situ.AudioBuffer.duration_ns(sound))
           )

    opts = [recognizer: PocketSphinx, recognizer_options: [grammar: @cards], partial: nil]

    test =
      Situ.Test.start([:sound, :speaking, :options], fn s ->
        Situ.via(Map.to_list(s), SpeechRecognizer, opts).out
      end)

    s = 1_000_000_000
    Situ.Test.advance(test, 60 * s)
    length = Situ.AudioBuffer.duration_ns(sound)

    heard = fn at ->
      speaking = for t <- (at - length + 1)..(at - 300_000_000)//100_000_000, do: {t, true}
      Situ.Test.feed(test, :sound, [{at, sound}])
      Situ.Test.feed(test, :speaking, speaking ++ [{at - 150_000_000, false}])
    end

    heard.(10 * s)

    # The inputs do not wait for each other: the first utterance is recognized before the grammar changes.
    Situ.Test.settle(test)
    Situ.Test.feed(test, :options, [{15 * s, [grammar: @other]}])
    heard.(30 * s)
    Situ.Test.close(test, :sound)
    Situ.Test.close(test, :speaking)
    said = for {_, utterance} <- Situ.Test.outputs(test), do: utterance
    assert [%{text: "ten of clubs", words: words} = first | rest] = said
    # Word times are in the time of the stream.
    assert hd(words).from >= first.from - 150_000_000 and List.last(words).to <= 10 * s
    # The other grammar contains other sentences, so the match has low confidence.
    assert Enum.all?(rest, &(&1.text =~ "good" and &1.confidence < 0.3))
    Situ.Test.stop(test)
  end

  test "returns alternatives from the grammar" do
    grammar =
      "#JSGF V1.0; grammar g; public <g> = (ten | five | nine) of (clubs | spades | hearts);"

    {:ok, sound} = Wav.read(@clip)
    {:ok, sphinx} = PocketSphinx.load(grammar: grammar, alternatives: 2)
    assert {:ok, %{text: "ten of clubs"} = heard} = PocketSphinx.transcribe(sphinx, sound)
    assert [%{text: other, confidence: next} | _] = heard.alternatives
    assert other =~ " of " and other != "ten of clubs"
    assert next <= heard.confidence and length(heard.alternatives) <= 2
  end

  test "has low confidence in speech that no sentence of the grammar fits" do
    {:ok, sphinx} = PocketSphinx.load(grammar: @cards)

    for name <- ~w(goforward sense_and_sensibility_01_austen_64kb-0930) do
      {:ok, sound} = Wav.read(Path.join(@fixtures, name <> ".wav"))
      assert {:ok, %{confidence: p}} = PocketSphinx.transcribe(sphinx, sound)
      assert p < 0.3, "#{name}: #{p}"
    end
  end

  test "finds a keyword only where it is spoken" do
    {:ok, sound} = Wav.read(Path.join(@fixtures, "goforward.wav"))
    {:ok, sphinx} = PocketSphinx.load(keyword: "forward", threshold: 1.0e-20)

    assert {:ok, %{text: "forward", confidence: p, words: [word]}} =
             PocketSphinx.transcribe(sphinx, sound)

    assert p > 0.5
    assert_in_delta word.from, 640_000_000, 100_000_000
    {:ok, cards} = Wav.read(@clip)
    assert {:ok, %{text: "", confidence: 0.0}} = PocketSphinx.transcribe(sphinx, cards)
  end

  test "recognizes most words of free speech, with alternatives" do
    {:ok, sound} = Wav.read(Path.join(@fixtures, "goforward.wav"))
    {:ok, sphinx} = PocketSphinx.load(alternatives: 5)

    assert {:ok, %{text: "go forward ten meters"} = heard} =
             PocketSphinx.transcribe(sphinx, sound)

    assert heard.confidence > 0.0 and heard.confidence <= 1.0
    assert length(heard.alternatives) in 1..5
  end

  test "a word that the dictionary lacks is an error" do
    {:ok, sphinx} = PocketSphinx.load(grammar: "#JSGF V1.0; grammar g; public <g> = zzyzxq;")
    {:ok, sound} = Wav.read(@clip)
    assert {:error, %{code: :recognition_failed}} = PocketSphinx.transcribe(sphinx, sound)
  end

  test "silence gives no text, and an invalid grammar is an error" do
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

defmodule Situ.Infer.Speech.EspeakTest do
  use ExUnit.Case, async: true
  doctest Situ.Infer.Speech.Espeak.OutputParser
  doctest Situ.Infer.Speech.Mark
  alias Situ.AudioBuffer
  alias Situ.Infer.Speech.Espeak

  @tag :tmp_dir
  test "SSML plays no local files, and broken markup is not an error", %{tmp_dir: dir} do
    file = Path.join(dir, "a.wav")
    noise = Situ.AudioBuffer.build_silence(Situ.AudioFormat.pcm(22_050), 5 * 22_050)
    :ok = Situ.Media.Wav.write(file, noise)
    {:ok, voice} = Espeak.load(ssml: true)
    {:ok, expected} = Espeak.speak(voice, "hello")

    for text <- [
          ~s(<audio src="#{file}"/>hello),
          ~s(<audio src="#{file}">hello</audio>),
          ~s(<au<audio x>dio src="#{file}"/>hello),
          "</speak>hello",
          ~s(<speak><prosody rate="160">hello)
        ] do
      assert {:ok, sound} = Espeak.speak(voice, text)

      assert Situ.AudioBuffer.duration_ns(sound) <
               Situ.AudioBuffer.duration_ns(expected) + 1_000_000_000

      assert {:ok, _, [_ | _]} = Espeak.speak_with_marks(voice, text)
    end
  end

  test "speaks faster and higher on request, and SSML with its pauses" do
    {:ok, slow} = Espeak.load(rate: 100)
    {:ok, fast} = Espeak.load(rate: 300)

    length = fn voice, text ->
      voice |> Espeak.speak(text) |> elem(1) |> AudioBuffer.duration_ns()
    end

    assert length.(slow, "one two three four") > 2 * length.(fast, "one two three four")

    {:ok, ssml} = Espeak.load(ssml: true)
    plain = length.(ssml, "<speak>one two</speak>")

    assert length.(ssml, ~s(<speak>one <break time="2000ms"/> two</speak>)) >
             plain + Situ.Time.ms(1_500)
  end

  test "reports the times of sentences, words, phonemes and SSML marks" do
    {:ok, voice} = Espeak.load(ssml: true)
    text = ~s(<speak>Go <mark name="here"/><break time="500ms"/>on.</speak>)
    {:ok, sound, marks} = Espeak.speak_with_marks(voice, text)
    of = fn kind -> Enum.filter(marks, &(&1.kind == kind)) end
    assert [%{text: "Go"} = go, %{text: "on"} = on] = of.(:word)
    assert [%{text: "here", from: here, to: here}] = of.(:mark)
    assert go.to <= here and on.from >= here + 250_000_000
    assert Enum.map_join(of.(:phoneme), & &1.text) == "ɡoʊɔn"
    assert Enum.all?(marks, &(&1.from <= &1.to and &1.to <= AudioBuffer.duration_ns(sound)))
    assert {:ok, %{data: data}} = Espeak.speak(voice, text)
    # The program and the library produce the same audio.
    assert_in_delta byte_size(sound.data), byte_size(data), 4_000
    assert {:ok, %{data: ""}, []} = Espeak.speak_with_marks(voice, "...")
  end

  test "truncated program output is an error" do
    alias Situ.Infer.Speech.Espeak.OutputParser
    good = <<"r", 4::little-32, 22_050::little-32, "a", 2::little-32, 1::16>>
    assert {:ok, _, []} = OutputParser.parse(good, "a")

    for n <- 0..(byte_size(good) - 1),
        n != 9,
        do: assert(OutputParser.parse(binary_part(good, 0, n), "a") == :error)

    assert OutputParser.parse(good <> <<"z", 0::32>>, "a") == :error
  end

  test "unspeakable text gives no audio, and invalid text or options are errors" do
    {:ok, voice} = Espeak.load()
    assert {:ok, %{data: ""}} = Espeak.speak(voice, "  ...  \n")
    assert {:error, %{code: :bad_text}} = Espeak.speak(voice, <<255>>)
    assert {:error, %{code: :bad_voice}} = Espeak.load(voice: "nobody")
    assert {:error, %{code: :bad_option}} = Espeak.load(rate: 1)
  end
end

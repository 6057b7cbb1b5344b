defmodule Situ.Infer.Speech.EspeakTest do
  use ExUnit.Case, async: true
  alias Situ.AudioBuffer
  alias Situ.Infer.Speech.Espeak

  test "speaks faster and higher when asked, and SSML with its pauses" do
    {:ok, slow} = Espeak.load(rate: 100)
    {:ok, fast} = Espeak.load(rate: 300)

    length = fn voice, text ->
      voice |> Espeak.speak(text) |> elem(1) |> AudioBuffer.duration()
    end

    assert length.(slow, "one two three four") > 2 * length.(fast, "one two three four")

    {:ok, ssml} = Espeak.load(ssml: true)
    plain = length.(ssml, "<speak>one two</speak>")

    assert length.(ssml, ~s(<speak>one <break time="2000ms"/> two</speak>)) >
             plain + Situ.Time.ms(1_500)
  end

  test "what cannot be said is nothing, what is wrong an error" do
    {:ok, voice} = Espeak.load()
    assert {:ok, %{data: ""}} = Espeak.speak(voice, "  ...  \n")
    assert {:error, %{code: :bad_text}} = Espeak.speak(voice, <<255>>)
    assert {:error, %{code: :bad_voice}} = Espeak.load(voice: "nobody")
    assert {:error, %{code: :bad_option}} = Espeak.load(rate: 1)
  end
end

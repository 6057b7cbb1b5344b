defmodule Situ.Infer.Speech.PunctuationTest do
  use ExUnit.Case, async: true
  alias Situ.Infer.Speech.Punctuation.Rules
  alias Situ.Infer.Speech.Utterance
  doctest Situ.Infer.Speech.Punctuation.Rules

  defp said(text), do: %Utterance{text: text, from: 0, to: 1, confidence: 0.9}

  defp run(texts, opts) do
    Situ.to_list(fn p ->
      p
      |> Situ.from_enumerable(Enum.map(texts, &said/1), every: 1)
      |> Situ.map(& &1, type: Utterance)
      |> Situ.Infer.punctuate(opts)
    end)
  end

  test "changes only the text of a stream's messages" do
    assert [one, two] = run(["is it true that i'm late", "Stop!"], [])
    assert one == said("Is it true that I'm late?")
    assert two.text == "Stop!"
  end

  test "only English has rules" do
    assert {:error, _} = Rules.load(language: "de")
  end
end

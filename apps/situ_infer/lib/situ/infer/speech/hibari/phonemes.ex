defmodule Situ.Infer.Speech.Hibari.Phonemes do
  @moduledoc false
  # Converts English text to the phoneme symbols that Hibari was trained with.
  #
  # espeak-ng transcribes the text in the International Phonetic Alphabet. Diphthongs and some
  # other phonemes are then replaced by single symbols, as in Kokoro's alphabet. Punctuation is
  # kept because it affects the intonation.
  alias Situ.Error
  alias Situ.Infer.Speech.{Program, TextCheck}

  @seconds 20
  @symbols [
    {"ʔˌn\u0329", "tᵊn"},
    {"a^ɪ", "I"},
    {"a^ʊ", "W"},
    {"d^ʒ", "ʤ"},
    {"e^ɪ", "A"},
    {"t^ʃ", "ʧ"},
    {"ɔ^ɪ", "Y"},
    {"ə^l", "ᵊl"},
    {"o^ʊ", "O"},
    {"ʔn", "tᵊn"},
    {"ʲO", "jO"},
    {"ɜːɹ", "ɜɹ"},
    {"ɜː", "ɜɹ"},
    {"ɪə", "iə"},
    {"\u0303", ""},
    {"e", "A"},
    {"r", "ɹ"},
    {"x", "k"},
    {"ç", "k"},
    {"ɐ", "ə"},
    {"ɚ", "əɹ"},
    {"ɬ", "l"},
    {"ʔ", "t"},
    {"ɾ", "T"},
    {"ʲ", ""},
    {"ː", ""},
    {"^", ""},
    {"\u0329", ""}
  ]

  @doc "Splits a text into sentences and converts each to a string of phonemes; sentences without words are dropped."
  @spec sentence_phonemes(String.t()) :: {:ok, [String.t()]} | {:error, Error.t()}
  def sentence_phonemes(text) do
    sentences = String.split(text, ~r/(?<=[.!?…])\s+|\n+/u, trim: true)

    with {:ok, signs} <- Error.map_ok(sentences, &convert_sentence/1),
         do: {:ok, Enum.reject(signs, &(&1 == ""))}
  end

  defp convert_sentence(sentence) do
    parts = Regex.split(~r/([,;:.!?…—]+)(?=\s|$)/u, sentence, include_captures: true, trim: true)

    with {:ok, clauses} <- Error.map_ok(parts, &convert_clause/1) do
      signs = Enum.join(clauses)
      {:ok, if(signs =~ ~r/\p{L}/u, do: String.trim(signs), else: "")}
    end
  end

  defp convert_clause(part) do
    cond do
      part =~ ~r/^[,;:.!?…—]+$/u -> {:ok, String.first(part) <> " "}
      TextCheck.speakable?(part) -> run_espeak(part)
      true -> {:ok, ""}
    end
  end

  defp run_espeak(part) do
    command = ["espeak-ng", "-q", "-v", "en-us", "--ipa", "--tie=^", "--", part]

    case Program.run(command, @seconds) do
      {ipa, 0} -> {:ok, ipa |> String.split() |> Enum.join(" ") |> translate_ipa()}
      {_, status} -> {:error, espeak_error(status)}
    end
  end

  defp espeak_error(status),
    do: Error.new(:synthesis_failed, "espeak-ng exited with status #{status}")

  @doc """
  Converts the phonetic alphabet written by `espeak-ng --ipa --tie=^` to Hibari's symbols.

      iex> Situ.Infer.Speech.Hibari.Phonemes.translate_ipa("həlˈo^ʊ d^ʒˈɔ^ɪ")
      "həlˈO ʤˈY"
  """
  @spec translate_ipa(String.t()) :: String.t()
  def translate_ipa(ipa) do
    Enum.reduce(@symbols, ipa, fn {from, to}, signs -> String.replace(signs, from, to) end)
  end
end

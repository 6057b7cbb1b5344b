defmodule Situ.Infer.Speech.Hibari.Phonemes do
  @moduledoc """
  Converts English text to the phoneme symbols that Hibari was trained with.

  espeak-ng transcribes the text in the International Phonetic Alphabet. Diphthongs and some other phonemes are then
  replaced by single symbols, as in Kokoro's alphabet. Punctuation is kept because it affects the intonation.

      iex> Situ.Infer.Speech.Hibari.Phonemes.translate("həlˈo^ʊ d^ʒˈɔ^ɪ")
      "həlˈO ʤˈY"
  """
  alias Situ.Error

  @seconds 20
  @tied [
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

  @doc "Checks that espeak-ng is installed; the error is `:no_espeak`."
  @spec ready() :: :ok | {:error, Error.t()}
  def ready do
    if System.find_executable("espeak-ng"),
      do: :ok,
      else:
        {:error,
         Error.new(:no_espeak, "the program espeak-ng is not installed",
           why: "it determines the pronunciation of words",
           fix: "install it: apt-get install espeak-ng"
         )}
  end

  @doc "Splits a text into sentences and converts each to a string of phonemes; sentences without words are dropped."
  @spec sentences(String.t()) :: {:ok, [String.t()]} | {:error, Error.t()}
  def sentences(text) do
    sentences = String.split(text, ~r/(?<=[.!?…])\s+|\n+/u, trim: true)

    with {:ok, signs} <- Error.map(sentences, &sentence/1),
         do: {:ok, Enum.reject(signs, &(&1 == ""))}
  end

  defp sentence(sentence) do
    parts = Regex.split(~r/([,;:.!?…—]+)(?=\s|$)/u, sentence, include_captures: true, trim: true)

    with {:ok, clauses} <- Error.map(parts, &clause/1) do
      signs = Enum.join(clauses)
      {:ok, if(signs =~ ~r/\p{L}/u, do: String.trim(signs), else: "")}
    end
  end

  defp clause(part) do
    cond do
      part =~ ~r/^[,;:.!?…—]+$/u -> {:ok, String.first(part) <> " "}
      part =~ ~r/[\p{L}\p{N}\p{S}]/u -> pronounced(part)
      true -> {:ok, ""}
    end
  end

  defp pronounced(part) do
    command =
      ["timeout", "-k", "1", "#{@seconds}", "espeak-ng", "-q", "-v", "en-us", "--ipa", "--tie=^"] ++
        ["--", part]

    case System.cmd("/bin/sh", ["-c", ~S(exec "$@" 2>/dev/null), "situ-speech" | command]) do
      {ipa, 0} -> {:ok, ipa |> String.split() |> Enum.join(" ") |> translate()}
      {_, status} -> {:error, failed(status)}
    end
  end

  defp failed(status),
    do: Error.new(:synthesis_failed, "espeak-ng exited with status #{status}")

  @doc "Converts the phonetic alphabet written by `espeak-ng --ipa --tie=^` to Hibari's symbols."
  @spec translate(String.t()) :: String.t()
  def translate(ipa) do
    Enum.reduce(@tied, ipa, fn {from, to}, signs -> String.replace(signs, from, to) end)
  end
end

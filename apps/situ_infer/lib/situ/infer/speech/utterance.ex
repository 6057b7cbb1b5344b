defmodule Situ.Infer.Speech.Utterance do
  @moduledoc """
  The words of one speaker: `text`, from `from` to `to` (ns, in the time of the audio), with a `confidence` of 0..1.
  `final?` is false while the person is still speaking, and the text may still change.

  If the recognizer supports them, `words` are the words with their times (ns) and `alternatives` are other possible
  texts, likeliest first. Otherwise both are empty.

      iex> said = %Situ.Infer.Speech.Utterance{text: "Ten of clubs.", from: 0, to: 900_000_000, confidence: 0.9}
      iex> Situ.Infer.Speech.Utterance.normalize_words(said.text)
      ["ten", "of", "clubs"]
  """
  alias Situ.Infer.Speech.Number

  @enforce_keys [:text, :from, :to, :confidence]
  defstruct [:text, :from, :to, :confidence, final?: true, words: [], alternatives: []]

  @type t :: %__MODULE__{
          text: String.t(),
          from: Situ.Time.t(),
          to: Situ.Time.t(),
          confidence: float(),
          final?: boolean(),
          words: [Situ.Infer.Speech.Recognizer.word()],
          alternatives: [Situ.Infer.Speech.Recognizer.alternative()]
        }

  @doc """
  Splits a text into words for comparison, without case and punctuation, and with numbers and titles written out.

      iex> Situ.Infer.Speech.Utterance.normalize_words("Mr. Dashwood, 10 meters!")
      ["mister", "dashwood", "ten", "meters"]
  """
  @spec normalize_words(String.t()) :: [String.t()]
  def normalize_words(text) do
    text
    |> String.downcase()
    |> String.replace(~r/[^\p{L}\p{N}' ]/u, " ")
    |> String.split()
    |> Enum.flat_map(&spell_out/1)
  end

  defp spell_out("mr"), do: ["mister"]
  defp spell_out("mrs"), do: ["missus"]
  defp spell_out("dr"), do: ["doctor"]

  defp spell_out(word) do
    if word =~ ~r/\A(0|[1-9][0-9]{0,2})\z/,
      do: word |> String.to_integer() |> Number.to_words() |> String.split(),
      else: [word]
  end

  @doc """
  Returns whether two lists have equally many words, and each word resembles its counterpart: the minimum Jaro
  similarity is `alike`.

      iex> Situ.Infer.Speech.Utterance.similar_words?(["komputer"], ["computer"], 0.88)
      true
  """
  @spec similar_words?([String.t()], [String.t()], number()) :: boolean()
  def similar_words?(words, others, alike) do
    length(words) == length(others) and
      words |> Enum.zip(others) |> Enum.all?(fn {a, b} -> String.jaro_distance(a, b) >= alike end)
  end

  @doc """
  Returns the word error rate: the number of inserted, deleted or substituted words, divided by the number of words in
  the truth.

      iex> Situ.Infer.Speech.Utterance.error_rate("four queen of clubs", "Four, queen of gloves!")
      0.25
      iex> Situ.Infer.Speech.Utterance.error_rate("", "hm")
      1.0
  """
  @spec error_rate(String.t(), String.t()) :: float()
  def error_rate(truth, heard) do
    {truth, heard} = {normalize_words(truth), normalize_words(heard)}
    edit_distance(truth, heard) / max(length(truth), 1)
  end

  # Computes the Levenshtein distance one row at a time.
  defp edit_distance(truth, heard) do
    first = Enum.to_list(0..length(heard))

    truth
    |> Enum.reduce(first, fn word, [corner | above] ->
      distance_row(word, heard, above, corner, [corner + 1])
    end)
    |> List.last()
  end

  defp distance_row(_word, [], [], _corner, row), do: Enum.reverse(row)

  defp distance_row(word, [other | heard], [up | above], corner, [left | _] = row) do
    change = if word == other, do: corner, else: corner + 1
    distance_row(word, heard, above, up, [Enum.min([change, up + 1, left + 1]) | row])
  end
end

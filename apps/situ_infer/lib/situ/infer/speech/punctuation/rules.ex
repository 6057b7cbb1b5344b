defmodule Situ.Infer.Speech.Punctuation.Rules do
  @moduledoc false
  # Adds English punctuation with rules: capitalizes the first word, "I", days and months, and
  # ends the text with a question mark if it begins like a question, or else with a period.
  # Existing punctuation at the end is kept.
  @behaviour Situ.Infer.Speech.Punctuation

  @asking ~w(what who whom whose which when where why how is are am was were do does did can could will would shall
             should may might has have had isn't aren't wasn't don't doesn't didn't can't couldn't won't wouldn't)
  @names ~w(monday tuesday wednesday thursday friday saturday sunday january february april june july august september
            october november december english)

  @impl true
  @spec load(keyword()) :: {:ok, :english} | {:error, Situ.Error.t()}
  def load(opts), do: with({:ok, _} <- Situ.Options.validate(opts, []), do: {:ok, :english})

  @doc """
  Adds punctuation to a text.

      iex> {:ok, rules} = Situ.Infer.Speech.Punctuation.Rules.load([])
      iex> Situ.Infer.Speech.Punctuation.Rules.punctuate(rules, "what day is it on monday i wonder")
      {:ok, "What day is it on Monday I wonder?"}
      iex> Situ.Infer.Speech.Punctuation.Rules.punctuate(rules, "go forward ten meters")
      {:ok, "Go forward ten meters."}
  """
  @impl true
  @spec punctuate(:english, String.t()) :: {:ok, String.t()}
  def punctuate(:english, text) do
    case String.split(text) do
      [] ->
        {:ok, ""}

      [first | _] = words ->
        {:ok,
         words
         |> Enum.map_join(" ", &capitalize_name/1)
         |> capitalize_first()
         |> add_end_mark(first)}
    end
  end

  defp capitalize_name("i"), do: "I"
  defp capitalize_name("i'" <> rest), do: "I'" <> rest
  defp capitalize_name(word) when word in @names, do: String.capitalize(word)
  defp capitalize_name(word), do: word

  defp capitalize_first(text) do
    {first, rest} = String.split_at(text, 1)
    String.upcase(first) <> rest
  end

  defp add_end_mark(text, first) do
    cond do
      String.ends_with?(text, [".", "?", "!", "…", ":"]) -> text
      String.downcase(first) in @asking -> text <> "?"
      true -> text <> "."
    end
  end
end

defmodule Situ.Infer.Speech.Punctuation do
  @moduledoc false
  # Turns words into sentences with capitals, periods and question marks. Some recognizers write
  # only words (PocketSphinx, telephone services); Moonshine already writes sentences.
  #
  #     heard |> Situ.Infer.punctuate()                                    # rules
  #     heard |> Situ.Infer.punctuate(punctuation: Situ.Chat.Punctuation, options: [model: "llama3.2"])
  #
  # | built in | method |
  # |---|---|
  # | `Situ.Infer.Speech.Punctuation.Rules` | rules based on the first words of English sentences |
  # | `Situ.Chat.Punctuation`, in `situ_assistant` | a language model (`Situ.Chat`) |
  #
  # To add another, implement these callbacks in a module.

  @doc "Loads the punctuation model or rules."
  @callback load(keyword()) :: {:ok, punctuation :: term()} | {:error, Situ.Error.t()}

  @doc "Returns the same words as sentences."
  @callback punctuate(punctuation :: term(), String.t()) ::
              {:ok, String.t()} | {:error, Situ.Error.t()}
end

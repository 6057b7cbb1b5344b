defmodule Situ.Infer.Speech.Punctuation do
  @moduledoc """
  Makes sentences of words: capitals, full stops, question marks. Some recognisers write words only (PocketSphinx,
  telephone services); Moonshine writes sentences already.

      heard |> Situ.Infer.punctuate()                                    # rules
      heard |> Situ.Infer.punctuate(punctuation: Situ.Infer.Speech.Punctuation.Model, options: [model: "llama3.2"])

  | built in | does it by |
  |---|---|
  | `Situ.Infer.Speech.Punctuation.Rules` | the first words of English sentences |
  | `Situ.Infer.Speech.Punctuation.Model` | a language model (`Situ.Chat`) |

  Another is a module with these callbacks.
  """

  @doc "Makes it ready."
  @callback load(keyword()) :: {:ok, punctuation :: term()} | {:error, Situ.Error.t()}

  @doc "The same words as sentences."
  @callback punctuate(punctuation :: term(), String.t()) ::
              {:ok, String.t()} | {:error, Situ.Error.t()}
end

defmodule Situ.Infer.Speech.Punctuation do
  @moduledoc """
  The behaviour of modules that turn words into sentences for `Situ.Infer.punctuate/2`.

  | built in | method |
  |---|---|
  | `:rules` | rules based on the first words of English sentences |
  | `Situ.Chat.Punctuation`, in `situ_assistant` | a language model |

  To add another, implement these callbacks in a module and pass it as `punctuation:`.
  """

  @doc "Loads the punctuation model or rules."
  @callback load(keyword()) :: {:ok, punctuation :: term()} | {:error, Situ.Error.t()}

  @doc "Returns the same words as sentences."
  @callback punctuate(punctuation :: term(), String.t()) ::
              {:ok, String.t()} | {:error, Situ.Error.t()}
end

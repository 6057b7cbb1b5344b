defmodule Situ.Chat.Punctuation do
  @moduledoc """
  Adds punctuation with a language model, for `Situ.Infer.punctuate/2`.

      heard |> Situ.Infer.punctuate(punctuation: Situ.Chat.Punctuation, options: [model: "llama3.2"])

  If the model changes the words, its output is discarded, and English rules are used instead. Errors are those of
  `Situ.Chat`.
  """

  Situ.Options.add_to_moduledoc(__MODULE__, Situ.Chat.Model.schema())

  @behaviour Situ.Infer.Speech.Punctuation
  alias Situ.{Chat, Error}
  alias Situ.Infer.Speech.Punctuation.Rules
  alias Situ.Infer.Speech.Utterance

  @system "Write the user's words as sentences, with capitals and punctuation. Keep every word and its order. " <>
            "Answer with the sentences only."

  @impl true
  @spec load(keyword()) :: {:ok, keyword()} | {:error, Error.t()}
  def load(opts) do
    with {:ok, opts} <- Situ.Options.validate(opts, Chat.Model.schema()),
         {:ok, _} <- Chat.Model.new(opts),
         do: {:ok, [{:system, @system} | opts]}
  end

  @impl true
  @spec punctuate(keyword(), String.t()) :: {:ok, String.t()} | {:error, Error.t()}
  def punctuate(opts, text) do
    if Utterance.normalize_words(text) == [] do
      {:ok, ""}
    else
      with {:ok, answer} <- Chat.ask(text, opts) do
        if Utterance.normalize_words(answer.text) == Utterance.normalize_words(text),
          do: {:ok, String.trim(answer.text)},
          else: Rules.punctuate(:english, text)
      end
    end
  end
end

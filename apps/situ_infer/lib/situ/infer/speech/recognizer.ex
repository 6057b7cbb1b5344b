defmodule Situ.Infer.Speech.Recognizer do
  @moduledoc """
  The behaviour of recognizers, which convert audio to text for `Situ.Infer.SpeechRecognizer`.

  | built in | use | runs |
  |---|---|---|
  | `Situ.Infer.Speech.Moonshine` | free English speech | locally, ONNX Runtime |
  | `Situ.Infer.Speech.PocketSphinx` | sentences of a grammar, keywords | locally, a program |
  | `Situ.Infer.Speech.OpenAI`, `Situ.Infer.Speech.Azure` | many languages | as a service |

  To add another, implement these callbacks in a module and pass it as `recognizer:`.
  """

  @typedoc """
  `confidence` is 0..1. If the recognizer supports them, `words` are the words with times (ns from the start of the
  audio), and `alternatives` are other possible texts, likeliest first.
  """
  @type result :: %{
          required(:text) => String.t(),
          required(:confidence) => float(),
          optional(:words) => [word()],
          optional(:alternatives) => [alternative()]
        }
  @type word :: %{
          required(:text) => String.t(),
          required(:from) => non_neg_integer(),
          required(:to) => non_neg_integer(),
          optional(:confidence) => float()
        }
  @type alternative :: %{text: String.t(), confidence: float()}

  @doc "Loads the model. Errors stop the pipeline before its first message."
  @callback load(keyword()) :: {:ok, model :: term()} | {:error, Situ.Error.t()}

  @doc "Returns the words in the audio, or an empty text if it contains none."
  @callback transcribe(model :: term(), Situ.AudioBuffer.t()) ::
              {:ok, result()} | {:error, Situ.Error.t()}
end

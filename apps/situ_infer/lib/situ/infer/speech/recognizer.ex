defmodule Situ.Infer.Speech.Recognizer do
  @moduledoc """
  A recognizer turns a piece of sound into text: the seam between `Situ.Infer.SpeechRecognizer` and a model.

  | built in | is for | runs |
  |---|---|---|
  | `Situ.Infer.Speech.Moonshine` | free English speech | here, ONNX Runtime |
  | `Situ.Infer.Speech.PocketSphinx` | sentences of a grammar, keywords | here, a program |
  | `Situ.Infer.Speech.OpenAI`, `Situ.Infer.Speech.Azure` | many languages | a service |

  Another is a module with these callbacks, named by the option `recognizer:`.
  """

  @typedoc """
  `confidence` is 0..1. `words` are those with times, ns from the beginning of the sound, where the recogniser knows
  them; `alternatives` what else it may have been, likeliest first.
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

  @doc "Loads it; errors stop the pipeline before its first message."
  @callback load(keyword()) :: {:ok, model :: term()} | {:error, Situ.Error.t()}

  @doc "The words in the sound; an empty text if there are none."
  @callback transcribe(model :: term(), Situ.AudioBuffer.t()) ::
              {:ok, result()} | {:error, Situ.Error.t()}
end

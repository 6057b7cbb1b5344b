defmodule Situ.Infer.Speech.WakeWord do
  @moduledoc """
  A spotter hears a name in speech: the seam between `Situ.Infer.wake_word/2` and a recogniser or keyword spotter.

  | built in | hears | for |
  |---|---|---|
  | `Situ.Infer.Speech.WakeWord.Spoken` | the name among the words of a recogniser (Moonshine) | any name, and few mistakes |
  | `Situ.Infer.Speech.WakeWord.Keyword` | the sounds of the name (PocketSphinx) | machines without ONNX Runtime |

  Another is a module with these callbacks, named by the option `spotter:`.
  """

  @typedoc "Where the name is, ns from the beginning of the sound; the whole sound where it is not known better."
  @type place :: %{from: non_neg_integer(), to: non_neg_integer(), confidence: float()}

  @doc "Makes it ready; `phrase:` is the name. Errors stop the pipeline before its first message."
  @callback load(keyword()) :: {:ok, spotter :: term()} | {:error, Situ.Error.t()}

  @doc "The places of the name in a piece of speech; none when it is not said."
  @callback spot(spotter :: term(), Situ.AudioBuffer.t()) ::
              {:ok, [place()]} | {:error, Situ.Error.t()}
end

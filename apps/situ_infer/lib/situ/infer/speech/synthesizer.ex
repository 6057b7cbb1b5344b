defmodule Situ.Infer.Speech.Synthesizer do
  @moduledoc """
  A synthesizer turns text into sound: the seam between `Situ.Infer.SpeechSynthesizer` and a program, model or
  service.

  | built in | is | runs | says when each word is spoken |
  |---|---|---|---|
  | `Situ.Infer.Speech.Espeak` | a robot in a hundred languages | here, a program | yes |
  | `Situ.Infer.Speech.Hibari` | one natural English voice | here, ONNX Runtime | no |
  | `Situ.Infer.Speech.OpenAI.Voice`, `Situ.Infer.Speech.Azure.Voice` | many voices | a service | no |

  Another is a module with these callbacks, named by the option `synthesizer:`.
  """

  @doc "Makes it ready; errors stop the pipeline before its first message."
  @callback load(keyword()) :: {:ok, voice :: term()} | {:error, Situ.Error.t()}

  @doc "The text spoken, in a format of the synthesizer's own; no frames for a text without words."
  @callback speak(voice :: term(), String.t()) :: Situ.AudioBuffer.result()

  @doc """
  The same with marks: sentences, words, phonemes and marks of the text, by their beginnings, in the time of the
  sound.
  """
  @callback speak_marked(voice :: term(), String.t()) ::
              {:ok, Situ.AudioBuffer.t(), [Situ.Infer.Speech.Mark.t()]}
              | {:error, Situ.Error.t()}
  @optional_callbacks speak_marked: 2
end

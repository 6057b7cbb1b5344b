defmodule Situ.Infer.Speech.Synthesizer do
  @moduledoc """
  The behaviour of synthesizers, which convert text to audio for `Situ.Infer.SpeechSynthesizer` using a program, model
  or service.

  | built in | voice | runs | reports word times |
  |---|---|---|---|
  | `Situ.Infer.Speech.Espeak` | robotic, in a hundred languages | locally, a program | yes |
  | `Situ.Infer.Speech.Hibari` | one natural English voice | locally, ONNX Runtime | no |
  | `Situ.Infer.Speech.OpenAI.Voice`, `Situ.Infer.Speech.Azure.Voice` | many voices | as a service | no |

  To add another, implement these callbacks in a module and pass it as `synthesizer:`.
  """

  @doc "Loads the voice. Errors stop the pipeline before its first message."
  @callback load(keyword()) :: {:ok, voice :: term()} | {:error, Situ.Error.t()}

  @doc "Speaks a text in any audio format; a text without words gives a buffer without frames."
  @callback speak(voice :: term(), String.t()) :: Situ.AudioBuffer.result()

  @doc """
  Speaks a text and also returns marks (sentences, words, phonemes and marks of the text), ordered by start time and
  relative to the start of the audio.
  """
  @callback speak_with_marks(voice :: term(), String.t()) ::
              {:ok, Situ.AudioBuffer.t(), [Situ.Infer.Speech.Mark.t()]}
              | {:error, Situ.Error.t()}
  @optional_callbacks speak_with_marks: 2
end

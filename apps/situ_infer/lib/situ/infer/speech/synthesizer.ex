defmodule Situ.Infer.Speech.Synthesizer do
  @moduledoc """
  What turns text into sound: the seam between `Situ.Infer.SpeechSynthesizer` and a program or model.

  `Situ.Infer.Speech.Espeak` is built in. Another is a module with these callbacks, named by the option `synthesizer:`.
  """

  @doc "Makes it ready; errors stop the pipeline before its first message."
  @callback load(keyword()) :: {:ok, voice :: term()} | {:error, Situ.Error.t()}

  @doc "The text spoken, in a format of the synthesizer's own; no frames for a text without words."
  @callback speak(voice :: term(), String.t()) :: Situ.AudioBuffer.result()
end

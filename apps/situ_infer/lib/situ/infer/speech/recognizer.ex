defmodule Situ.Infer.Speech.Recognizer do
  @moduledoc """
  What turns a piece of sound into text: the seam between `Situ.Infer.SpeechRecognizer` and a model.

  `Situ.Infer.Speech.Moonshine` is built in. Another is a module with these callbacks, named by the option
  `recognizer:`.
  """

  @type result :: %{required(:text) => String.t(), required(:confidence) => float()}

  @doc "Loads it; errors stop the pipeline before its first message."
  @callback load(keyword()) :: {:ok, model :: term()} | {:error, Situ.Error.t()}

  @doc "What is said in the sound; an empty text when that is nothing."
  @callback transcribe(model :: term(), Situ.AudioBuffer.t()) ::
              {:ok, result()} | {:error, Situ.Error.t()}
end

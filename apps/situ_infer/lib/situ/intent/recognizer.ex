defmodule Situ.Intent.Recognizer do
  @moduledoc """
  A recognizer finds the intent in a text: the seam between `Situ.Intent.Detector` and a grammar, a language model, or
  a module of your own with these callbacks.
  """

  @doc "Makes it ready; errors stop the pipeline before its first message."
  @callback load(keyword()) :: {:ok, recognizer :: term()} | {:error, Situ.Error.t()}

  @doc "The intents and entities of a text; without any when it knows none."
  @callback detect(recognizer :: term(), String.t()) ::
              {:ok, Situ.Intent.t()} | {:error, Situ.Error.t()}
end

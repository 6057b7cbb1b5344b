defmodule Situ.Intent.Recognizer do
  @moduledoc false
  # Behaviour of recognizers, which detect the intent of a text for `Situ.Intent.Detector`. A
  # grammar and a language model are built in.

  @doc "Loads the recognizer. Errors stop the pipeline before its first message."
  @callback load(keyword()) :: {:ok, recognizer :: term()} | {:error, Situ.Error.t()}

  @doc "Returns the intents and entities of a text; both are empty if nothing matches."
  @callback detect(recognizer :: term(), String.t()) ::
              {:ok, Situ.Intent.t()} | {:error, Situ.Error.t()}
end

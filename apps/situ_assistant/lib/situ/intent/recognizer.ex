defmodule Situ.Intent.Recognizer do
  @moduledoc """
  The behaviour of recognizers, which detect the intent of a text for `Situ.Intent.Detector`.

  `Situ.Intent.Grammar` and `Situ.Intent.LanguageModel` are built in. To add another, implement these callbacks in a
  module and pass it as `recognizer:`.
  """

  @doc "Loads the recognizer. Errors stop the pipeline before its first message."
  @callback load(keyword()) :: {:ok, recognizer :: term()} | {:error, Situ.Error.t()}

  @doc "Returns the intents and entities of a text; both are empty if nothing matches."
  @callback detect(recognizer :: term(), String.t()) ::
              {:ok, Situ.Intent.t()} | {:error, Situ.Error.t()}
end

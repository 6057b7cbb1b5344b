defmodule Situ.Infer.Speech.WakeWord do
  @moduledoc """
  The behaviour of spotters, which detect a name in speech for `Situ.Infer.wake_word/2`.

  `Situ.Infer.wake_word/2` describes the two that are built in. To add another, implement these callbacks in a module
  and pass it as `spotter:`.
  """

  @typedoc "The interval of the name, in ns from the start of the audio; all of the audio if it is not known exactly."
  @type span :: %{from: non_neg_integer(), to: non_neg_integer(), confidence: float()}

  @doc "Loads the spotter; `phrase:` is the name. Errors stop the pipeline before its first message."
  @callback load(keyword()) :: {:ok, spotter :: term()} | {:error, Situ.Error.t()}

  @doc "Returns the intervals of the name in the audio, or an empty list if it is not spoken."
  @callback spot_phrase(spotter :: term(), Situ.AudioBuffer.t()) ::
              {:ok, [span()]} | {:error, Situ.Error.t()}
end

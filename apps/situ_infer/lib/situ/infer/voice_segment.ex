defmodule Situ.Infer.VoiceSegment do
  @moduledoc """
  A segment of speech, from `start` to `stop` (nanoseconds, times of the audio).

      iex> Situ.Infer.VoiceSegment.duration(%Situ.Infer.VoiceSegment{start: 100, stop: 350})
      250
  """
  @enforce_keys [:start, :stop]
  defstruct [:start, :stop]

  @type t :: %__MODULE__{start: Situ.Time.t(), stop: Situ.Time.t()}

  @doc "Returns the duration in nanoseconds."
  @spec duration(t()) :: Situ.Time.duration()
  def duration(%__MODULE__{start: start, stop: stop}), do: stop - start
end

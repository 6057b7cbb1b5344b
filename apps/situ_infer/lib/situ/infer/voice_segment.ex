defmodule Situ.Infer.VoiceSegment do
  @moduledoc false
  # A segment of speech, from `start` to `stop` (nanoseconds, times of the audio).
  @enforce_keys [:start, :stop]
  defstruct [:start, :stop]

  @type t :: %__MODULE__{start: Situ.Time.t(), stop: Situ.Time.t()}

  @doc """
  Returns the duration in nanoseconds.

      iex> Situ.Infer.VoiceSegment.duration(%Situ.Infer.VoiceSegment{start: 100, stop: 350})
      250
  """
  @spec duration(t()) :: Situ.Time.duration()
  def duration(%__MODULE__{start: start, stop: stop}), do: stop - start
end

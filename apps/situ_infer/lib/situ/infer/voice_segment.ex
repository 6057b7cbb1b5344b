defmodule Situ.Infer.VoiceSegment do
  @moduledoc """
  A stretch of speech: it began at `start` and was over at `stop` (nanoseconds, times of the sound).

      iex> Situ.Infer.VoiceSegment.duration(%Situ.Infer.VoiceSegment{start: 100, stop: 350})
      250
  """
  @enforce_keys [:start, :stop]
  defstruct [:start, :stop]

  @type t :: %__MODULE__{start: Situ.Time.t(), stop: Situ.Time.t()}

  @doc "How long it lasted, in nanoseconds."
  @spec duration(t()) :: Situ.Time.duration()
  def duration(%__MODULE__{start: start, stop: stop}), do: stop - start
end

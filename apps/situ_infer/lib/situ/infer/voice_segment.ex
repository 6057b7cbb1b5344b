defmodule Situ.Infer.VoiceSegment do
  @moduledoc false
  # A segment of speech, from `start` to `stop` (nanoseconds, times of the audio).
  @enforce_keys [:start, :stop]
  defstruct [:start, :stop]

  @type t :: %__MODULE__{start: Situ.Time.t(), stop: Situ.Time.t()}
end

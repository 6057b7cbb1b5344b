defmodule Situ.Infer.Voice do
  @moduledoc false
  # The voice activity in one short span of audio.
  #
  #   * `probability`: the probability that somebody speaks, 0..1
  #   * `level`: the root mean square of the samples, 0..1 of full scale
  @enforce_keys [:probability, :level]
  defstruct [:probability, :level]

  @type t :: %__MODULE__{probability: float(), level: float()}
end

defmodule Situ.Infer.Voice do
  @moduledoc """
  The voice activity in one short span of audio.

    * `probability`: the probability that somebody speaks, 0..1
    * `level`: the root mean square of the samples, 0..1 of full scale

      iex> Situ.Infer.Voice.level_db(%Situ.Infer.Voice{probability: 0.9, level: 0.1})
      -20.0
  """
  @enforce_keys [:probability, :level]
  defstruct [:probability, :level]

  @type t :: %__MODULE__{probability: float(), level: float()}

  @doc "Returns the level in dB of full scale; -120 for silence."
  @spec level_db(t()) :: float()
  def level_db(%__MODULE__{level: level}) when level < 1.0e-6, do: -120.0
  def level_db(%__MODULE__{level: level}), do: 20 * :math.log10(level)
end

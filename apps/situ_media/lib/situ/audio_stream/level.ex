defmodule Situ.AudioStream.Level do
  @moduledoc false
  # The level of a buffer of audio. `Situ.AudioOps.level/1` documents the fields.
  @enforce_keys [:peak, :rms, :peak_db, :rms_db, :channels]
  defstruct [:peak, :rms, :peak_db, :rms_db, :channels]

  @type t :: %__MODULE__{
          peak: float(),
          rms: float(),
          peak_db: float(),
          rms_db: float(),
          channels: [{float(), float()}]
        }

  @floor_db -120.0

  @doc """
  Builds a level from the peak and root mean square of each channel.

      iex> Situ.AudioStream.Level.new([{1.0, 0.5}]).peak_db
      0.0
  """
  @spec new([{float(), float()}, ...]) :: t()
  def new(channels) do
    peak = channels |> Enum.map(&elem(&1, 0)) |> Enum.max()
    power = channels |> Enum.map(fn {_, rms} -> rms * rms end) |> Enum.sum()
    rms = :math.sqrt(power / length(channels))

    %__MODULE__{
      peak: peak,
      rms: rms,
      peak_db: to_decibels(peak),
      rms_db: to_decibels(rms),
      channels: channels
    }
  end

  @doc "Converts a fraction of full scale to decibels."
  @spec to_decibels(float()) :: float()
  def to_decibels(value) when value <= 1.0e-6, do: @floor_db
  def to_decibels(value), do: 20 * :math.log10(value)
end

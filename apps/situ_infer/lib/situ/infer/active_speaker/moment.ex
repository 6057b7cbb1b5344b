defmodule Situ.Infer.ActiveSpeaker.Moment do
  @moduledoc false
  # The mouths in one image, and the voice heard at its time.
  @enforce_keys [:time, :mouths, :probability, :loudness]
  defstruct [:time, :mouths, :probability, :loudness, voice?: false]

  @type t :: %__MODULE__{}

  @spec new(Situ.Time.t(), map(), Situ.Infer.Voice.t() | nil, float()) :: t()
  def new(time, mouths, nil, _compress),
    do: %__MODULE__{time: time, mouths: mouths, probability: 0.0, loudness: 0.0}

  def new(time, mouths, voice, compress) do
    loudness = if voice.level > 0.0, do: :math.pow(voice.level, compress), else: 0.0
    %__MODULE__{time: time, mouths: mouths, probability: voice.probability, loudness: loudness}
  end
end

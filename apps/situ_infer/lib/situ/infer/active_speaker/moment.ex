defmodule Situ.Infer.ActiveSpeaker.Moment do
  @moduledoc false
  # The mouths in one image, and the voice heard at its time.
  @enforce_keys [:time, :mouths, :probability, :loudness]
  defstruct [:time, :mouths, :probability, :loudness, voice?: false]

  @type t :: %__MODULE__{}

  @spec new(Situ.Time.t(), map(), Situ.Infer.Voice.t() | nil) :: t()
  def new(time, mouths, nil),
    do: %__MODULE__{time: time, mouths: mouths, probability: 0.0, loudness: 0.0}

  def new(time, mouths, voice) do
    loudness = compress_loudness(voice.level)
    %__MODULE__{time: time, mouths: mouths, probability: voice.probability, loudness: loudness}
  end

  @doc "Compresses a level, because twice the loudness does not mean twice the opening of a mouth."
  @spec compress_loudness(float()) :: float()
  def compress_loudness(level) when level > 0.0, do: :math.pow(level, 0.7)
  def compress_loudness(_level), do: 0.0
end

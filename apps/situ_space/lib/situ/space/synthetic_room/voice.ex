defmodule Situ.Space.SyntheticRoom.Voice do
  @moduledoc false
  # The audio in the synthetic room: a speaking person hums four syllables a second, each person
  # at a different pitch. Samples depend only on their number, so the audio is the same however it
  # is split into buffers.
  @pitches %{0 => 118.0, 1 => 205.0}
  @harmonics [{1, 1.0}, {2, 0.7}, {3, 0.5}, {4, 0.6}, {6, 0.35}, {9, 0.2}]
  @loudness 5_200

  @doc """
  Returns the 16-bit samples with these numbers at `rate` per second; calls `speaks?` with an id
  and seconds.

      iex> alias Situ.Space.SyntheticRoom.Voice
      iex> Voice.generate_samples(0..3, 16_000, fn _id, _t -> false end)
      [0, 0, 0, 0]
  """
  @spec generate_samples(Range.t(), pos_integer(), (term(), float() -> boolean())) :: [integer()]
  def generate_samples(numbers, rate, speaks?) do
    for n <- numbers do
      t = n / rate

      round(
        @loudness *
          Enum.sum(for {id, pitch} <- @pitches, speaks?.(id, t), do: hum_sample(t, pitch))
      )
    end
  end

  defp hum_sample(t, pitch) do
    syllable = :math.pow(:math.sin(:math.pi() * 4 * t), 2)
    glide = pitch * t + 3.0 * :math.sin(2 * :math.pi() * 0.6 * t)

    for({k, a} <- @harmonics, do: a * :math.sin(2 * :math.pi() * k * glide))
    |> Enum.sum()
    |> Kernel.*(syllable)
  end
end

defmodule Situ.Studio.Draw.Rhythm do
  @moduledoc """
  How often messages come, and which pauses are holes: something is missing there, and nothing may be drawn across.
  The page has the same rule for lines (`assets/js/data/rhythm.js`).

      iex> every_ten = for t <- Enum.concat(0..50//10, 500..600//10), do: {t, 1}
      iex> Situ.Studio.Draw.Rhythm.holes(every_ten)
      [{60, 500}]
      iex> Situ.Studio.Draw.Rhythm.holes([{0, 1}, {10, 1}, {500, 1}, {503, 1}, {600, 1}])
      []
  """
  @looked_at 256
  # A pause of so many periods is a hole in what comes regularly.
  @missed 8
  # Messages come regularly when nine of ten pauses are not longer than so many usual ones.
  @steady 2.5

  @typedoc "The time of the first of some messages, and how many there are until the next row."
  @type row :: {Situ.Time.t(), pos_integer()}

  @doc "From where on and until when nothing is known, in order; a message holds until its successor is due."
  @spec holes([row()]) :: [{Situ.Time.t(), Situ.Time.t()}]
  def holes(rows) do
    case period(rows) do
      :irregular ->
        []

      {period, row} ->
        patience = max(row + @missed * period, 1.5 * row)

        for [{t, n}, {next, _}] <- Enum.chunk_every(rows, 2, 1, :discard),
            next - t > patience,
            do: {t + round(max(period * n, row)), next}
    end
  end

  defp period(rows) do
    pairs = Enum.chunk_every(rows, 2, 1, :discard)
    every = max(div(length(pairs), @looked_at), 1)
    some = Enum.take_every(pairs, every)
    periods = Enum.sort(for [{t, n}, {next, _}] <- some, do: (next - t) / n)
    pauses = Enum.sort(for [{t, _}, {next, _}] <- some, do: next - t)
    usual = middle(periods)

    if length(pairs) >= 4 and Enum.at(periods, div(length(periods) * 9, 10)) <= @steady * usual,
      do: {usual, middle(pauses)},
      else: :irregular
  end

  defp middle([]), do: 0
  defp middle(sorted), do: Enum.at(sorted, div(length(sorted), 2))
end

defmodule Situ.Studio.Draw.GapDetection do
  @moduledoc false
  # Determines how often messages arrive and which pauses are gaps. Messages are missing in a gap,
  # so nothing may be drawn across it. The page applies the same rule to lines
  # (`assets/js/data/gap_detection.js`).
  @looked_at 256
  # In a regular stream, a pause of this many periods is a gap.
  @missed 8
  # A stream is regular if nine of ten pauses are at most this many times as long as the usual one.
  @steady 2.5

  @typedoc "The time of the first of some messages, and the number of messages until the next row."
  @type row :: {Situ.Time.t(), pos_integer()}

  @doc """
  Returns the gaps as time ranges, in order. A message holds until its successor is due.

      iex> every_ten = for t <- Enum.concat(0..50//10, 500..600//10), do: {t, 1}
      iex> Situ.Studio.Draw.GapDetection.find_gaps(every_ten)
      [{60, 500}]
      iex> Situ.Studio.Draw.GapDetection.find_gaps([{0, 1}, {10, 1}, {500, 1}, {503, 1}, {600, 1}])
      []
  """
  @spec find_gaps([row()]) :: [{Situ.Time.t(), Situ.Time.t()}]
  def find_gaps(rows) do
    case usual_period(rows) do
      :irregular ->
        []

      {period, row} ->
        patience = max(row + @missed * period, 1.5 * row)

        for [{t, n}, {next, _}] <- Enum.chunk_every(rows, 2, 1, :discard),
            next - t > patience,
            do: {t + round(max(period * n, row)), next}
    end
  end

  defp usual_period(rows) do
    pairs = Enum.chunk_every(rows, 2, 1, :discard)
    every = max(div(length(pairs), @looked_at), 1)
    some = Enum.take_every(pairs, every)
    periods = Enum.sort(for [{t, n}, {next, _}] <- some, do: (next - t) / n)
    pauses = Enum.sort(for [{t, _}, {next, _}] <- some, do: next - t)
    usual = median(periods)

    if length(pairs) >= 4 and Enum.at(periods, div(length(periods) * 9, 10)) <= @steady * usual,
      do: {usual, median(pauses)},
      else: :irregular
  end

  defp median([]), do: 0
  defp median(sorted), do: Enum.at(sorted, div(length(sorted), 2))
end

defmodule Situ.Store.Rotation.Retention do
  @moduledoc false
  # Determines the segments of a recording that exceed `keep:`. Originating times of messages are not used, because a
  # single incorrect time must not delete anything. Segments split by time count with their nominal length. For
  # segments split by size, the caller passes the times at which they ended, as read from the computer's clock.
  # See docs/adr/0132-long-recordings-are-split-into-segments.md.

  @typedoc """
  A segment: its `size` in bytes, its `duration` in ns of originating time, and when it `ended` by the computer's clock.
  Unknown values are `nil`.
  """
  @type piece :: %{
          size: non_neg_integer(),
          duration: non_neg_integer() | nil,
          ended: integer() | nil
        }

  @doc """
  Returns how many of the oldest segments must be deleted. `pieces` are the closed segments, oldest first. The `open`
  segments are still being written, so they count but are not deleted. `now` is from the same clock as `ended`.
  """
  @spec count_surplus(Situ.Store.Rotation.keep(), [piece()], [piece()], integer()) ::
          non_neg_integer()
  def count_surplus(nil, _pieces, _open, _now), do: 0

  def count_surplus({:bytes, most}, pieces, open, _now) do
    pieces
    |> Enum.map(& &1.size)
    |> count_beyond(sum_field(open, :size), fn newer, size -> newer + size <= most end)
  end

  # These segments are split by time. The newest is incomplete and does not count.
  def count_surplus({:span, span}, pieces, [%{duration: duration} | _] = open, _now)
      when is_integer(duration) do
    pieces
    |> Enum.map(&(&1.duration || 0))
    |> count_beyond(open |> Enum.drop(-1) |> sum_field(:duration), fn newer, _ -> newer < span end)
  end

  # A segment that ended that long ago is deleted together with all older ones, regardless of their clock times.
  def count_surplus({:span, span}, pieces, _open, now) do
    pieces
    |> Enum.with_index(1)
    |> Enum.filter(fn {piece, _} -> piece.ended != nil and now - piece.ended >= span end)
    |> List.last({nil, 0})
    |> elem(1)
  end

  defp sum_field(pieces, key), do: pieces |> Enum.map(& &1[key]) |> Enum.sum()

  # Counts the elements left over after keeping the newest ones while `room?.(sum_of_newer, this)` is true.
  defp count_beyond(amounts, start, room?) do
    amounts
    |> Enum.reverse()
    |> Enum.reduce_while({start, length(amounts)}, fn amount, {newer, left} ->
      if room?.(newer, amount),
        do: {:cont, {newer + amount, left - 1}},
        else: {:halt, {newer, left}}
    end)
    |> elem(1)
  end
end

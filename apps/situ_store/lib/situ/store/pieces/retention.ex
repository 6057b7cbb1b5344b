defmodule Situ.Store.Pieces.Retention do
  @moduledoc false
  # Which pieces of a recording `keep:` has no room for. Originating times of messages do not count, because a single
  # wrong one must not delete anything. Pieces cut by time count by their nominal length; for pieces cut by size, the
  # moment counts at which they ended by the computer's clock, which the caller reads.

  @typedoc """
  A piece: its `size` in bytes, its `duration` in ns of originating time, and when it `ended` by the computer's clock.
  Unknown values are `nil`.
  """
  @type piece :: %{
          size: non_neg_integer(),
          duration: non_neg_integer() | nil,
          ended: integer() | nil
        }

  @doc """
  Returns how many of the oldest pieces are to be deleted. `pieces` are the closed ones, oldest first. The `open` ones
  are still being written: they count, but are not deleted. `now` is by the same clock as `ended`.
  """
  @spec count_surplus(Situ.Store.Pieces.keep(), [piece()], [piece()], integer()) ::
          non_neg_integer()
  def count_surplus(nil, _pieces, _open, _now), do: 0

  def count_surplus({:bytes, most}, pieces, open, _now) do
    pieces
    |> Enum.map(& &1.size)
    |> count_beyond(sum(open, :size), fn newer, size -> newer + size <= most end)
  end

  # Pieces are cut by time here. The newest is incomplete and does not count.
  def count_surplus({:span, span}, pieces, [%{duration: duration} | _] = open, _now)
      when is_integer(duration) do
    pieces
    |> Enum.map(&(&1.duration || 0))
    |> count_beyond(open |> Enum.drop(-1) |> sum(:duration), fn newer, _ -> newer < span end)
  end

  # A piece that ended that long ago is deleted, and with it all older ones, whatever the clock showed then.
  def count_surplus({:span, span}, pieces, _open, now) do
    pieces
    |> Enum.with_index(1)
    |> Enum.filter(fn {piece, _} -> piece.ended != nil and now - piece.ended >= span end)
    |> List.last({nil, 0})
    |> elem(1)
  end

  defp sum(pieces, key), do: pieces |> Enum.map(& &1[key]) |> Enum.sum()

  # Goes from the newest to the oldest for as long as `room?.(sum_of_newer, this)` holds.
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

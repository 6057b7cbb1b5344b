defmodule Situ.Store.Pieces.Retention do
  @moduledoc false
  # Which pieces of a recording `keep:` has no room for. Pure. No originating time counts here: a single message with a
  # wrong one must not delete anything. The amount recorded counts, by the time that pieces are cut at, or the moment a
  # piece ended by the clock of the computer, which the caller reads.

  @typedoc """
  A piece, of which `size` is its bytes, `duration` the originating time that it is whole of (ns), and `ended` when the
  next one was begun by the computer's clock; `nil` of what cannot be known.
  """
  @type piece :: %{
          size: non_neg_integer(),
          duration: non_neg_integer() | nil,
          ended: integer() | nil
        }

  @doc """
  How many of the oldest pieces are to be deleted. `pieces` are the closed ones, oldest first, and `open` the ones that
  are being written: they stay, but count. `now` is by the same clock as `ended`.
  """
  @spec surplus(Situ.Store.Pieces.keep(), [piece()], [piece()], integer()) :: non_neg_integer()
  def surplus(nil, _pieces, _open, _now), do: 0

  def surplus({:bytes, most}, pieces, open, _now) do
    pieces
    |> Enum.map(& &1.size)
    |> count_beyond(sum(open, :size), fn newer, size -> newer + size <= most end)
  end

  # Of pieces that are cut by time: the newest is not whole yet and does not count.
  def surplus({:span, span}, pieces, [%{duration: duration} | _] = open, _now)
      when is_integer(duration) do
    pieces
    |> Enum.map(&(&1.duration || 0))
    |> count_beyond(open |> Enum.drop(-1) |> sum(:duration), fn newer, _ -> newer < span end)
  end

  # One that ended so long ago goes, and with it all that are older, whatever their clock said.
  def surplus({:span, span}, pieces, _open, now) do
    pieces
    |> Enum.with_index(1)
    |> Enum.filter(fn {piece, _} -> piece.ended != nil and now - piece.ended >= span end)
    |> List.last({nil, 0})
    |> elem(1)
  end

  defp sum(pieces, key), do: pieces |> Enum.map(& &1[key]) |> Enum.sum()

  # From the newest to the oldest, as long as `room?.(sum_of_newer, this)`.
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

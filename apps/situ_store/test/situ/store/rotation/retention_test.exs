defmodule Situ.Store.Rotation.RetentionTest do
  use ExUnit.Case, async: true
  alias Situ.Store.Rotation.Retention

  defp piece(fields), do: Map.merge(%{size: 0, duration: nil, ended: nil}, Map.new(fields))
  defp count_surplus(keep, closed, open), do: Retention.count_surplus(keep, closed, open, 1_000)

  test "keeps everything without a limit" do
    assert count_surplus(nil, [piece(size: 1)], []) == 0
  end

  test "a byte limit counts open segments but never deletes them" do
    closed = for size <- [5, 5, 5], do: piece(size: size)
    assert count_surplus({:bytes, 100}, closed, [piece(size: 7)]) == 0
    assert count_surplus({:bytes, 17}, closed, [piece(size: 7)]) == 1
    assert count_surplus({:bytes, 16}, closed, [piece(size: 7)]) == 2
    assert count_surplus({:bytes, 1}, closed, [piece(size: 7)]) == 3
  end

  test "a span keeps enough complete segments, not counting the newest" do
    closed = for _ <- 1..5, do: piece(duration: 10)
    open = [piece(duration: 10), piece(duration: 10)]
    assert count_surplus({:span, 30}, closed, open) == 3
    assert count_surplus({:span, 31}, closed, open) == 2
    # Segments that may be incomplete do not cause other segments to be deleted.
    short = for _ <- 1..9, do: piece(duration: 0)
    assert count_surplus({:span, 30}, closed ++ short, open) == 3

    assert count_surplus({:span, 30}, closed ++ short, [piece(duration: 0), piece(duration: 10)]) ==
             2
  end

  test "by the system clock, deletes segments that ended too long ago and all older ones" do
    closed = for ended <- [nil, 100, 5_000, 700, 900], do: piece(ended: ended)
    assert count_surplus({:span, 901}, closed, [piece([])]) == 0
    assert count_surplus({:span, 900}, closed, [piece([])]) == 2
    assert count_surplus({:span, 300}, closed, [piece([])]) == 4
    assert count_surplus({:span, 100}, closed, [piece([])]) == 5
    assert count_surplus({:span, 100}, [], [piece([])]) == 0
  end
end

defmodule Situ.Store.Pieces.CutTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.Pieces.Cut

  test "by time: multiples, before the epoch too" do
    cut = Cut.new(10)
    assert Enum.map([-11, -10, -1, 0, 9, 10], &Cut.number(cut, &1)) == [-2, -1, -1, 0, 0, 1]
  end

  test "by size: from the time that was cut at on" do
    cut = Cut.new({:bytes, 100})
    assert Cut.number(cut, -5) == 0
    :ok = Cut.cut(cut, 50)
    assert {Cut.number(cut, 49), Cut.number(cut, 50)} == {0, 1}
    :ok = Cut.cut(cut, 60)
    assert {Cut.number(cut, 59), Cut.number(cut, 60)} == {1, 2}
  end

  property "a stream whose times increase never goes back a piece" do
    forall steps <- list({non_neg_integer(), boolean()}) do
      cut = Cut.new({:bytes, 1})

      Enum.reduce(steps, {0, 0}, fn {step, cut?}, {time, number} ->
        if cut?, do: Cut.cut(cut, time + 1)
        time = time + 1 + step
        now = Cut.number(cut, time)
        true = now >= number
        {time, now}
      end)

      true
    end
  end
end

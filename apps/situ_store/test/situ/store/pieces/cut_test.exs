defmodule Situ.Store.Rotation.CutTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.Rotation.SplitPoint

  test "splits by time at multiples of the duration, also before the epoch" do
    cut = SplitPoint.new(10)

    assert Enum.map([-11, -10, -1, 0, 9, 10], &SplitPoint.segment_number(cut, &1)) == [
             -2,
             -1,
             -1,
             0,
             0,
             1
           ]
  end

  test "splits by size from the time of each cut" do
    cut = SplitPoint.new({:bytes, 100})
    assert SplitPoint.segment_number(cut, -5) == 0
    :ok = SplitPoint.begin_segment(cut, 50)
    assert {SplitPoint.segment_number(cut, 49), SplitPoint.segment_number(cut, 50)} == {0, 1}
    :ok = SplitPoint.begin_segment(cut, 60)
    assert {SplitPoint.segment_number(cut, 59), SplitPoint.segment_number(cut, 60)} == {1, 2}
  end

  property "a stream with increasing times never returns to an earlier segment" do
    forall steps <- list({non_neg_integer(), boolean()}) do
      cut = SplitPoint.new({:bytes, 1})

      Enum.reduce(steps, {0, 0}, fn {step, cut?}, {time, number} ->
        if cut?, do: SplitPoint.begin_segment(cut, time + 1)
        time = time + 1 + step
        now = SplitPoint.segment_number(cut, time)
        true = now >= number
        {time, now}
      end)

      true
    end
  end
end

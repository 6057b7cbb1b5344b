defmodule Situ.Store.Rotation.SplitPointTest do
  use ExUnit.Case, async: true
  alias Situ.Store.Rotation.SplitPoint

  test "a stream whose times increase never returns to an earlier segment while segments begin" do
    split_point = SplitPoint.new({:bytes, 1})
    clock = :atomics.new(1, signed: true)

    # Segment i begins at time 10 i, and the stream's time is 10 i + 5.
    writer =
      Task.async(fn ->
        for i <- 1..200_000 do
          SplitPoint.begin_segment(split_point, 10 * i)
          :atomics.put(clock, 1, 10 * i + 5)
        end
      end)

    assert count_returns(split_point, clock, 0, 0) == 0
    Task.await(writer)
  end

  defp count_returns(split_point, clock, last, returns) do
    number = SplitPoint.segment_number(split_point, :atomics.get(clock, 1))
    returns = if number < last, do: returns + 1, else: returns
    if number == 200_000, do: returns, else: count_returns(split_point, clock, number, returns)
  end
end

defmodule Situ.Store.Summary.BinsTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Store.Summary.Bins
  alias Situ.Store.Test.Sound

  property "bins contain the extremes, last values and counts of their points" do
    forall {values, level} <- {list({integer(0, 50), float()}), integer(0, 10)} do
      points =
        values
        |> Enum.scan({-100, 0.0}, fn {step, x}, {time, _} -> {time + step + 1, x} end)
        |> Enum.map(fn {time, x} -> {time, x, x, x, 1} end)

      expected =
        for {start, points} <- Enum.group_by(points, &Bins.bin_start(elem(&1, 0), level)) do
          xs = Enum.map(points, &elem(&1, 1))
          {start, Enum.min(xs), Enum.max(xs), List.last(xs), length(xs)}
        end

      Bins.fold_points(points, level) == Enum.sort(expected)
    end
  end

  test "returns the signal of a message" do
    points = fn data -> Bins.message_points(%Situ.Message{data: data, originating_time: 7}) end
    assert points.(3) == [{7, 3.0, 3.0, 3.0, 1}]
    assert points.(true) == [{7, 1.0, 1.0, 1.0, 1}]
    assert points.(false) == [{7, 0.0, 0.0, 0.0, 1}]
    assert [{7, 5, 5, 5, 1}, {1_007, 6, 6, 6, 1}] = points.(%Sound{samples: [5, 6]})
    assert points.("text") == [] and points.(nil) == [] and points.(%URI{}) == []
    assert Bins.bin_start(-1, 3) == -8
  end
end

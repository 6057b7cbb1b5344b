defmodule Situ.PointCloudTest do
  use ExUnit.Case, async: true
  alias Situ.PointCloud

  test "omits points without a position and keeps the points after them" do
    nan = <<0, 0, 0xC0, 0x7F>>
    point = fn x -> <<x::little-float-32, 0::64>> end
    cloud = %PointCloud{points: nan <> <<0::64>> <> point.(1) <> <<0::64>> <> nan <> point.(2)}
    assert PointCloud.to_points(cloud) == [{1.0, 0.0, 0.0}, {2.0, 0.0, 0.0}]
  end
end

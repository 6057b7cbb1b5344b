defmodule Situ.GeoPointTest do
  use ExUnit.Case, async: true
  doctest Situ.GeoPoint
  alias Situ.GeoPoint

  test "converts a ROS fix with its position and accuracy" do
    fix = %{
      "latitude" => 46.5,
      "longitude" => 14.25,
      "altitude" => 300.5,
      "position_covariance" => [4.0, 0, 0, 0, 9.0, 0, 0, 0, 16.0]
    }

    assert {:ok, place} = GeoPoint.from_data(fix)
    assert {place.latitude, place.height, place.accuracy} == {46.5, 300.5, 3.0}

    assert {:ok, %{accuracy: nil}} =
             GeoPoint.from_data(%{fix | "position_covariance" => [0, 0, 0, 0, 0]})

    assert GeoPoint.from_data(%{fix | "latitude" => 95}) == :error
  end

  test "radius/1 returns the horizontal accuracy" do
    assert {:ok, place} = GeoPoint.new(1, 2, accuracy: {4, 3, 9})
    assert {place.accuracy, GeoPoint.horizontal_accuracy(place)} == {{4.0, 3.0, 9.0}, 4.0}
    assert GeoPoint.from_data(place) == {:ok, place}
    assert {:ok, %{accuracy: nil}} = GeoPoint.new(1, 2, accuracy: {:nan, 1, 1})
    assert {:error, %{code: :bad_place}} = GeoPoint.new(:nan, 1.0)
  end

  test "keys may be atoms, longitudes wrap around, and other terms are refused" do
    assert {:ok, %{longitude: -170.0}} = GeoPoint.from_data(%{lat: 1, lon: 190})

    for term <- [nil, [], "46, 14", %{lat: 1}, %{lat: nil, lon: 2}, %Situ.Point2{x: 1, y: 2}],
        do: assert(GeoPoint.from_data(term) == :error)
  end
end

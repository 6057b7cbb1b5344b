defmodule Situ.GeoPositionTest do
  use ExUnit.Case, async: true
  doctest Situ.GeoPosition

  test "what is no place is refused" do
    assert {:error, %{code: :bad_place}} = Situ.GeoPosition.new(:nan, 1.0)
    assert {:error, %{code: :bad_place}} = Situ.GeoPosition.new(1.0, 1.0, "high")
    assert {:ok, %{latitude: 1.0, altitude: nil}} = Situ.GeoPosition.new(1, 2)
  end
end

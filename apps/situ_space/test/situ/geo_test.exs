defmodule Situ.GeoTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Geo, Quaternion, Vector3}
  doctest Geo

  defp place,
    do:
      {map(integer(-9_000, 9_000), &(&1 / 100)), map(integer(-17_999, 18_000), &(&1 / 100)),
       map(integer(-5_000, 90_000), &(&1 / 10))}

  property "conversion there and back returns the same point" do
    forall {{lat, lon, height} = place, origin} <- {place(), place()} do
      {lat2, lon2, height2} = place |> Geo.to_ecef() |> Geo.from_ecef()
      assert_in_delta lat, lat2, 1.0e-9
      if abs(lat) < 89.99, do: assert(abs(:math.sin((lon - lon2) * :math.pi() / 360)) < 1.0e-9)
      assert_in_delta height, height2, 1.0e-5

      local = Geo.to_enu(place, origin)
      assert_in_delta Vector3.norm(local), Geo.distance(place, origin), 1.0e-5
      assert Geo.distance(Geo.from_enu(local, origin), place) < 1.0e-5

      moved = Vector3.subtract(Geo.to_ecef(place), Geo.to_ecef(origin))

      assert Vector3.distance(Quaternion.rotate_vector(Geo.enu_rotation(origin), local), moved) <
               1.0e-4
    end
  end

  # NIMA TR8350.2: the semi-axes are the distances at which the axes leave the ellipsoid.
  test "converts the ends of the axes" do
    assert Geo.to_ecef({0.0, 0.0, 0.0}) == {6_378_137.0, 0.0, 0.0}
    {x, y, z} = Geo.to_ecef({90.0, 0.0, 0.0})
    assert_in_delta z, 6_356_752.314245, 1.0e-6
    assert abs(x) < 1.0e-9 and y == 0.0
    {lat, _, height} = Geo.from_ecef({0.0, 0.0, -6_356_752.314245})
    assert_in_delta lat, -90.0, 1.0e-9
    assert_in_delta height, 0.0, 1.0e-6
  end

  # Degrees of latitude and longitude in meters at 45 degrees, from the radii of curvature M and N.
  test "a small step north and east is as long as the radii of curvature predict" do
    {a, e2} = {6_378_137.0, 0.00669437999014}
    w = 1 - e2 / 2
    degree = :math.pi() / 180
    {_, north, _} = Geo.to_enu({45.0005, 7.0, 0.0}, {44.9995, 7.0, 0.0})
    assert_in_delta north, 0.001 * degree * a * (1 - e2) / :math.pow(w, 1.5), 1.0e-4
    {east, _, _} = Geo.to_enu({45.0, 7.001, 0.0}, {45.0, 7.0, 0.0})
    assert_in_delta east, 0.001 * degree * a / :math.sqrt(w) * :math.cos(45 * degree), 1.0e-4
  end

  test "an invalid place is an error" do
    assert {:error, %{code: :bad_place}} = Geo.validate_position("46", 14.0)
    assert {:error, %{code: :bad_place}} = Geo.validate_position(:nan, 14.0)
    assert {:error, %{code: :bad_place}} = Geo.validate_position(46.0, 514.0)
    assert Geo.validate_position(46, 14) == {:ok, {46.0, 14.0, 0.0}}
  end
end

defmodule Situ.Infer.FaceMeshTest do
  use ExUnit.Case, async: true
  alias Situ.Infer.{FaceMesh, Patch}

  test "returns points in image pixels, and distances in pixels of the patch" do
    points = for i <- 0..467, v <- [i, 2, 0], into: <<>>, do: <<v::float-native-32>>
    patch = Patch.centered_at({96.0, 96.0}, 192.0, 0.0, 192)
    rect = Situ.Rect.new!(0, 0, 1, 1)
    mesh = %FaceMesh{id: 0, rect: rect, score: 1.0, points: points, patch: patch}
    assert FaceMesh.point_at(mesh, 13) == {13.0, 2.0}
    assert Enum.at(FaceMesh.points(mesh), 13) == {13.0, 2.0}
    assert FaceMesh.point_distance(mesh, 13, 14) == 1.0
  end
end

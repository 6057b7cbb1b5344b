defmodule Situ.SurfacesTest do
  # Intersections and nearest points of triangles, meshes, facets and rectangles with images.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{Box3, Line3, Mesh, PointCloud, Pose, PoseVelocity, Quaternion, Ray3, Rectangle3}
  alias Situ.{Triangle3, Vector3}

  doctest Line3
  doctest PoseVelocity
  doctest Triangle3

  defp coordinate, do: map(integer(-500, 500), &(&1 / 100))
  defp vector, do: {coordinate(), coordinate(), coordinate()}

  defp pose do
    map({vector(), coordinate(), coordinate(), coordinate()}, fn {position, yaw, pitch, roll} ->
      Pose.new(position, Quaternion.from_euler(yaw, pitch, roll))
    end)
  end

  # Builds a box from twelve triangles, two per facet.
  @sides [{0, 2, 6, 4}, {1, 3, 7, 5}, {0, 1, 5, 4}, {2, 3, 7, 6}, {0, 1, 3, 2}, {4, 5, 7, 6}]
  defp mesh(%Box3{pose: pose} = box) do
    triangles = for {a, b, c, d} <- @sides, t <- [{a, b, c}, {a, c, d}], do: t
    {:ok, mesh} = Mesh.from_lists(Box3.corner_points(%{box | pose: nil}), triangles)
    %{mesh | pose: pose}
  end

  property "a ray hits the mesh of a box where it hits the box" do
    box = Box3.new!({-1.0, -2.0, -0.5}, {1.0, 2.0, 0.5})

    forall {pose, from, way} <- {pose(), vector(), vector()} do
      box = Box3.transform(box, pose)

      with {:ok, ray} <- Ray3.new(from, way) do
        case {Box3.intersect_ray(box, ray), Mesh.intersect_ray(mesh(box), ray)} do
          {nil, nil} -> :ok
          {{at, _}, {found, n}} when n in 0..11 -> assert Vector3.distance(at, found) < 1.0e-4
          # This ray touches an edge.
          {hit, miss} -> assert grazes?(box, hit || miss)
        end
      end
    end
  end

  defp grazes?(box, {at, _}) do
    {x, y, z} = Pose.transform_point(Pose.invert(box.pose), at)

    near =
      Enum.count([{abs(x), 1}, {abs(y), 2}, {abs(z), 0.5}], fn {v, e} -> abs(v - e) < 1.0e-4 end)

    near >= 2
  end

  property "from outside, the nearest point of a box's mesh is that of the box" do
    box = Box3.new!({-1.0, -2.0, -0.5}, {1.0, 2.0, 0.5})

    forall {pose, point} <- {pose(), vector()} do
      box = Box3.transform(box, pose)

      unless Box3.contains_point?(box, point) do
        {found, _} = Mesh.closest_point(mesh(box), point)
        assert Vector3.distance(found, Box3.closest_point(box, point)) < 1.0e-4
      end
    end
  end

  property "no other point of a triangle is closer than the closest point" do
    forall {a, b, c, point} <- {vector(), vector(), vector(), vector()} do
      nearest = Triangle3.closest_point({a, b, c}, point)
      least = Vector3.distance(nearest, point)

      for u <- 0..10, v <- 0..(10 - u) do
        on_it =
          a
          |> Vector3.add(Vector3.scale(Vector3.subtract(b, a), u / 10))
          |> Vector3.add(Vector3.scale(Vector3.subtract(c, a), v / 10))

        assert Vector3.distance(on_it, point) >= least - 1.0e-9
        assert Triangle3.contains_point?({a, b, c}, on_it, 1.0e-6)
      end
    end
  end

  test "handles empty meshes, invalid indices and vertices that are not numbers" do
    {:ok, ray} = Ray3.new({0.0, 0.0, 0.0}, {1.0, 0.0, 0.0})
    assert Mesh.intersect_ray(%Mesh{vertices: <<>>, indices: <<>>}, ray) == nil
    assert Mesh.closest_point(%Mesh{vertices: <<>>, indices: <<>>}, {0.0, 0.0, 0.0}) == nil

    {:ok, good} =
      Mesh.from_lists([{1.0, -1.0, -1.0}, {1.0, 1.0, -1.0}, {1.0, 0.0, 1.0}], [{0, 1, 2}])

    wrong = %{good | indices: <<0::32, 1::little-32, 9::little-32>>}
    assert Mesh.intersect_ray(wrong, ray) == nil
    nan = <<0, 0, 0xC0, 0x7F>>
    holes = %{good | vertices: nan <> binary_part(good.vertices, 4, 32)}
    assert Mesh.closest_point(holes, {0.0, 0.0, 0.0}) == nil
    # A triangle without area is never hit, and its closest point is its corner.
    {:ok, flat} = Mesh.from_lists([{1.0, 0.0, 0.0}], [{0, 0, 0}])
    assert Mesh.intersect_ray(flat, ray) == nil
    assert Mesh.closest_point(flat, {0.0, 0.0, 0.0}) == {{1.0, 0.0, 0.0}, 0}
  end

  test "converts a mesh to a cloud at its pose" do
    {:ok, mesh} =
      Mesh.from_lists([{1.0, 0.0, 0.0}, {0.0, 1.0, 0.0}, {0.0, 0.0, 1.0}], [{0, 1, 2}])

    moved = Mesh.transform(mesh, Pose.new({0.0, 0.0, 2.0}))

    assert PointCloud.to_points(Mesh.to_cloud(moved)) ==
             [{1.0, 0.0, 2.0}, {0.0, 1.0, 2.0}, {0.0, 0.0, 3.0}]
  end

  property "a box's facets span its corners and face outward" do
    forall {pose, {w, d, h}} <- {pose(), {integer(1, 9), integer(1, 9), integer(1, 9)}} do
      box = Box3.new!({0.0, 0.0, 0.0}, {w * 1.0, d * 1.0, h * 1.0}, pose)
      corners = Box3.corner_points(box)

      for name <- Box3.facet_names() do
        facet = Box3.facet_rectangle(box, name)

        for corner <- Rectangle3.corner_points(facet),
            do: assert(Enum.any?(corners, &(Vector3.distance(&1, corner) < 1.0e-6)))

        out = Vector3.subtract(facet.pose.position, Box3.center_point(box))
        assert Vector3.dot_product(Rectangle3.containing_plane(facet).normal, out) > 0
        assert facet.width * facet.height > 0
      end
    end
  end

  property "converting a pixel to a point on a rectangle and back returns the pixel" do
    forall {pose, px, py} <- {pose(), integer(0, 640), integer(0, 480)} do
      wall = Rectangle3.new!(pose, 2.0, 1.5)
      point = Rectangle3.from_pixel(wall, {px, py}, {640, 480})
      {x, y} = Rectangle3.to_pixel(wall, point, {640, 480}, 1.0e-6) || {px, py}
      assert_in_delta x, px, 1.0e-6
      assert_in_delta y, py, 1.0e-6
    end
  end

  test "a point outside the rectangle of an image has no pixel" do
    wall = Rectangle3.new!(Pose.identity(), 2.0, 1.5)
    assert Rectangle3.to_pixel(wall, {0.5, 0.0, 0.0}, {640, 480}) == nil
    assert Rectangle3.to_pixel(wall, {0.5, 0.0, 0.0}, {640, 480}, 1) == {320.0, 240.0}
    assert Rectangle3.to_pixel(wall, {0.0, 2.0, 0.0}, {640, 480}) == nil

    assert Rectangle3.to_pixel(Rectangle3.new!(Pose.identity(), 0, 1), {0.0, 0.0, 0.0}, {4, 4}) ==
             nil
  end

  property "extrapolates position and rotation at constant velocity" do
    forall {a, b} <- {pose(), pose()} do
      {:ok, velocity} = PoseVelocity.from_poses(a, b, Situ.Time.ms(100))
      next = PoseVelocity.pose_after(velocity, Situ.Time.ms(100))
      back = PoseVelocity.pose_after(velocity, -Situ.Time.ms(100))
      assert Vector3.distance(back.position, a.position) < 1.0e-6
      assert Quaternion.angle_between(back.rotation, a.rotation) < 1.0e-5
      expected = Vector3.lerp(a.position, b.position, 2.0)
      assert Vector3.distance(next.position, expected) < 1.0e-6
    end
  end

  test "returns an error for a velocity over zero time" do
    assert {:error, %{code: :bad_duration}} =
             PoseVelocity.from_poses(Pose.identity(), Pose.identity(), 0)
  end

  test "a cloud with values round-trips, with and without colours" do
    for colors <- [nil, <<1, 2, 3, 4, 5, 6>>] do
      {:ok, cloud} =
        PointCloud.new(<<0::192>>, colors, <<1.5::little-float-32, 2.5::little-float-32>>)

      bytes = cloud |> PointCloud.encode() |> IO.iodata_to_binary()
      assert PointCloud.decode(bytes) == {:ok, cloud}
      assert {:error, _} = PointCloud.decode(binary_part(bytes, 0, byte_size(bytes) - 1))
      assert PointCloud.transform(cloud, Pose.identity()).values == cloud.values
    end

    assert {:error, %{code: :bad_cloud}} = PointCloud.new(<<0::192>>, nil, <<0::32>>)
  end

  test "a moved cloud with invalid points keeps its colours aligned with its points" do
    nan = <<0, 0, 0xC0, 0x7F>>
    {:ok, cloud} = PointCloud.new(<<nan::binary, 0::64>> <> <<0::96>>, <<1, 2, 3, 4, 5, 6>>)
    moved = PointCloud.transform(cloud, Pose.new({1.0, 0.0, 0.0}))
    assert PointCloud.point_count(moved) == 2
    assert PointCloud.to_points(moved) == [{1.0, 0.0, 0.0}]

    assert {:ok, ^moved} =
             moved |> PointCloud.encode() |> IO.iodata_to_binary() |> PointCloud.decode()
  end
end

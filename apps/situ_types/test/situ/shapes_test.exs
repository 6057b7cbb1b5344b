defmodule Situ.ShapesTest do
  # Tests the three-dimensional shapes together, with the same rays and points.
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.{
    Box3,
    CameraIntrinsics,
    CameraView,
    Mesh,
    Plane,
    PointCloud,
    Pose,
    Quaternion,
    Ray3,
    Rectangle3
  }

  alias Situ.{Skeleton, Vector3, Velocity3, VoxelGrid}

  doctest Box3
  doctest CameraIntrinsics
  doctest Situ.CameraView
  doctest Situ.Transform
  doctest Situ.ImuReading
  doctest Mesh
  doctest Plane
  doctest PointCloud
  doctest Ray3
  doctest Rectangle3
  doctest Skeleton
  doctest Velocity3
  doctest VoxelGrid

  defp coordinate, do: map(integer(-500, 500), &(&1 / 100))
  defp vector, do: {coordinate(), coordinate(), coordinate()}

  defp pose do
    map({vector(), coordinate(), coordinate(), coordinate()}, fn {position, yaw, pitch, roll} ->
      Pose.new(position, Quaternion.from_euler(yaw, pitch, roll))
    end)
  end

  defp ray do
    map({vector(), vector()}, fn {origin, direction} ->
      direction = if direction == {0.0, 0.0, 0.0}, do: {1.0, 0.0, 0.0}, else: direction
      {:ok, ray} = Ray3.new(origin, direction)
      ray
    end)
  end

  defp box do
    map({vector(), vector(), pose()}, fn {{ax, ay, az}, {bx, by, bz}, pose} ->
      Box3.new!(
        {min(ax, bx), min(ay, by), min(az, bz)},
        {max(ax, bx), max(ay, by), max(az, bz)},
        pose
      )
    end)
  end

  property "a ray hits a box on its surface in front of the origin, and a ray that misses has no point inside" do
    forall {box, ray} <- {box(), ray()} do
      case Box3.intersect_ray(box, ray) do
        {point, facet} ->
          assert Box3.contains_point?(box, point, 1.0e-6)
          assert Ray3.distance_to(ray, point) < 1.0e-6
          assert facet in [:x_min, :x_max, :y_min, :y_max, :z_min, :z_max]

        nil ->
          for step <- 0..40,
              do: refute(Box3.contains_point?(box, Ray3.point_at(ray, step / 4), -1.0e-6))
      end
    end
  end

  property "the closest point of a box is in the box, and no corner is closer" do
    forall {box, point} <- {box(), vector()} do
      closest = Box3.closest_point(box, point)
      assert Box3.contains_point?(box, closest, 1.0e-6)

      nearest_corner =
        box |> Box3.corner_points() |> Enum.map(&Vector3.distance(&1, point)) |> Enum.min()

      assert Vector3.distance(closest, point) <= nearest_corner + 1.0e-6
    end
  end

  property "a transformed box contains the transformed points" do
    forall {box, pose, point} <- {box(), pose(), vector()} do
      # Points on the surface may be on either side.
      if Box3.contains_point?(box, point, 1.0e-6) == Box3.contains_point?(box, point, -1.0e-6) do
        assert Box3.contains_point?(Box3.transform(box, pose), Pose.transform_point(pose, point)) ==
                 Box3.contains_point?(box, point)
      end
    end
  end

  property "a ray hits a rectangle where it hits the plane, within the corners" do
    forall {pose, ray} <- {pose(), ray()} do
      rectangle = Rectangle3.new!(pose, 4, 2)
      point = Plane.intersect_ray(Rectangle3.containing_plane(rectangle), ray)
      hit = Rectangle3.intersect_ray(rectangle, ray)
      assert hit == nil or hit == point

      if hit do
        {_, y, z} = Pose.transform_point(Pose.invert(pose), hit)
        assert abs(y) <= 2.000001 and abs(z) <= 1.000001
      end
    end
  end

  property "projecting onto a plane returns the nearest point" do
    forall {a, b, c, point} <- {vector(), vector(), vector(), vector()} do
      with {:ok, plane} <- Plane.from_points(a, b, c) do
        foot = Plane.project_point(plane, point)
        assert_in_delta Plane.signed_distance(plane, foot), 0.0, 1.0e-6
        assert Vector3.distance(foot, point) <= Vector3.distance(a, point) + 1.0e-6
      end
    end
  end

  property "clouds and meshes round-trip, and other bytes are refused without raising" do
    forall {points, colored?, bytes} <- {list(vector()), boolean(), binary()} do
      %{points: data} = PointCloud.from_points(points)
      colors = if colored?, do: :binary.copy(<<1, 2, 3>>, length(points))
      {:ok, cloud} = PointCloud.new(data, colors)

      assert {:ok, ^cloud} =
               cloud |> PointCloud.encode() |> IO.iodata_to_binary() |> PointCloud.decode()

      triangles = if length(points) > 2, do: [{0, 1, 2}, {2, 1, 0}], else: []
      {:ok, mesh} = Mesh.from_lists(points, triangles)
      mesh = if colored?, do: Mesh.transform(mesh, Pose.new({1.0, 2.0, 3.0})), else: mesh
      assert {:ok, ^mesh} = mesh |> Mesh.encode() |> IO.iodata_to_binary() |> Mesh.decode()

      for module <- [PointCloud, Mesh, CameraIntrinsics],
          prefix <- ["", <<1>>, <<1, 1, 0, 0>>],
          do: assert({:error, %Situ.Error{}} = module.decode(prefix <> bytes))
    end
  end

  test "camera intrinsics round-trip" do
    camera =
      CameraIntrinsics.new!(
        width: 640,
        height: 480,
        focal: {500, 510},
        radial: [0.1, -0.2],
        tangential: {0.01, 0}
      )

    assert {:ok, ^camera} = camera |> CameraIntrinsics.encode() |> CameraIntrinsics.decode()

    assert {:error, %{code: :bad_camera}} =
             CameraIntrinsics.new(
               width: 1,
               height: 1,
               focal: {1, 1},
               radial: List.duplicate(0, 7)
             )
  end

  test "refuses inconsistent clouds with an error that says why" do
    assert {:error, %{what: "13 bytes are not a whole number of points of 12 bytes"}} =
             PointCloud.new(<<0::104>>)

    assert {:error, %{what: "1 points have 2 bytes of colour"}} =
             PointCloud.new(<<0::96>>, <<0, 0>>)

    assert PointCloud.bounding_box(PointCloud.from_points([])) == nil
    assert PointCloud.centroid(PointCloud.from_points([])) == nil
  end

  test "a view keeps its camera when the viewed value changes" do
    camera = CameraIntrinsics.new!(width: 2, height: 1, focal: {1, 1})
    view = CameraView.new(:picture, camera, Pose.identity())

    assert {:ok, %CameraView{viewed: "picture", intrinsics: ^camera}} =
             CameraView.map_viewed(view, &{:ok, to_string(&1)})

    assert {:error, :no} = CameraView.map_viewed(view, fn _ -> {:error, :no} end)
  end

  test "measures angular velocity around the rotation axis" do
    from = Pose.identity()
    to = Pose.new({0.0, 0.0, 0.0}, Quaternion.from_euler(0.5, 0, 0))
    assert {:ok, velocity} = Velocity3.angular_between(from, to, Situ.Time.ms(100))
    assert_in_delta velocity.magnitude, 5.0, 1.0e-9
    assert {:error, %{code: :bad_duration}} = Velocity3.linear_between(from, to, 0)
  end

  property "an interpolated skeleton has the joints that both skeletons have" do
    forall {a, b, percent} <- {vector(), vector(), integer(0, 100)} do
      left = Skeleton.new!(%{hand: Pose.new(a), elbow: Pose.new(b)}, [{:hand, :elbow}])
      right = Skeleton.new!(%{hand: Pose.new(b)}, [])
      between = Skeleton.interpolate(left, right, percent / 100)
      assert Map.keys(between.joints) == [:hand] and between.bones == []

      assert Vector3.distance(
               Skeleton.joint_position(between, :hand),
               Vector3.lerp(a, b, percent / 100)
             ) < 1.0e-9
    end
  end
end

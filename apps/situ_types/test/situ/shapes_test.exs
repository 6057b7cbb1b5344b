defmodule Situ.ShapesTest do
  # The shapes of space together: the same rays and points against each of them.
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

  property "a ray meets a box on its skin, in front of itself; points along it never lie inside where it misses" do
    forall {box, ray} <- {box(), ray()} do
      case Box3.intersection(box, ray) do
        {point, facet} ->
          assert Box3.contains?(box, point, 1.0e-6)
          assert Ray3.distance(ray, point) < 1.0e-6
          assert facet in [:x_min, :x_max, :y_min, :y_max, :z_min, :z_max]

        nil ->
          for step <- 0..40,
              do: refute(Box3.contains?(box, Ray3.point_at(ray, step / 4), -1.0e-6))
      end
    end
  end

  property "the closest point of a box lies in it, and no corner is closer" do
    forall {box, point} <- {box(), vector()} do
      closest = Box3.closest_point(box, point)
      assert Box3.contains?(box, closest, 1.0e-6)

      nearest_corner =
        box |> Box3.corners() |> Enum.map(&Vector3.distance(&1, point)) |> Enum.min()

      assert Vector3.distance(closest, point) <= nearest_corner + 1.0e-6
    end
  end

  property "a transformed box holds the transformed points" do
    forall {box, pose, point} <- {box(), pose(), vector()} do
      # Points on the skin may fall either way.
      if Box3.contains?(box, point, 1.0e-6) == Box3.contains?(box, point, -1.0e-6) do
        assert Box3.contains?(Box3.transform(box, pose), Pose.transform(pose, point)) ==
                 Box3.contains?(box, point)
      end
    end
  end

  property "a rectangle is met where its plane is met, inside its corners" do
    forall {pose, ray} <- {pose(), ray()} do
      rectangle = Rectangle3.new!(pose, 4, 2)
      point = Plane.intersection(Rectangle3.plane(rectangle), ray)
      hit = Rectangle3.intersection(rectangle, ray)
      assert hit == nil or hit == point

      if hit do
        {_, y, z} = Pose.transform(Pose.invert(pose), hit)
        assert abs(y) <= 2.000001 and abs(z) <= 1.000001
      end
    end
  end

  property "projecting on a plane gives its nearest point" do
    forall {a, b, c, point} <- {vector(), vector(), vector(), vector()} do
      with {:ok, plane} <- Plane.through(a, b, c) do
        foot = Plane.project(plane, point)
        assert_in_delta Plane.distance(plane, foot), 0.0, 1.0e-6
        assert Vector3.distance(foot, point) <= Vector3.distance(a, point) + 1.0e-6
      end
    end
  end

  property "clouds, meshes and cameras are read back; any other bytes are refused, never raise" do
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

  test "intrinsics are read back" do
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

  test "clouds that do not add up are refused with what is wrong" do
    assert {:error, %{what: "13 bytes are no whole number of points of 12 bytes"}} =
             PointCloud.new(<<0::104>>)

    assert {:error, %{what: "1 points have 2 bytes of colour"}} =
             PointCloud.new(<<0::96>>, <<0, 0>>)

    assert PointCloud.bounds(PointCloud.from_points([])) == nil
    assert PointCloud.centroid(PointCloud.from_points([])) == nil
  end

  test "a view keeps its camera when what it views changes" do
    camera = CameraIntrinsics.new!(width: 2, height: 1, focal: {1, 1})
    view = CameraView.new(:picture, camera, Pose.identity())

    assert {:ok, %CameraView{viewed: "picture", intrinsics: ^camera}} =
             CameraView.map(view, &{:ok, to_string(&1)})

    assert {:error, :no} = CameraView.map(view, fn _ -> {:error, :no} end)
  end

  test "turning is measured around its axis" do
    from = Pose.identity()
    to = Pose.new({0.0, 0.0, 0.0}, Quaternion.from_euler(0.5, 0, 0))
    assert {:ok, velocity} = Velocity3.angular(from, to, Situ.Time.ms(100))
    assert_in_delta velocity.magnitude, 5.0, 1.0e-9
    assert {:error, %{code: :bad_duration}} = Velocity3.linear(from, to, 0)
  end

  property "skeletons between two have the joints of both" do
    forall {a, b, percent} <- {vector(), vector(), integer(0, 100)} do
      left = Skeleton.new!(%{hand: Pose.new(a), elbow: Pose.new(b)}, [{:hand, :elbow}])
      right = Skeleton.new!(%{hand: Pose.new(b)}, [])
      between = Skeleton.interpolate(left, right, percent / 100)
      assert Map.keys(between.joints) == [:hand] and between.bones == []

      assert Vector3.distance(
               Skeleton.position(between, :hand),
               Vector3.lerp(a, b, percent / 100)
             ) < 1.0e-9
    end
  end
end

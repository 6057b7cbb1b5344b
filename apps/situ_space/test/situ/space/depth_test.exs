defmodule Situ.Space.DepthTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{CameraIntrinsics, CameraView, DepthImage, Mesh, PointCloud, Pose, Ray3, Vector3}
  alias Situ.Space.{Camera, Depth, RayTable}
  doctest Depth
  doctest RayTable

  @camera CameraIntrinsics.new!(
            width: 8,
            height: 6,
            focal: {7, 7.5},
            principal: {3.9, 3.1},
            radial: [0.1, -0.05, 0.0, 0.02],
            tangential: {0.001, -0.002}
          )

  defp depth(values, semantics \\ :plane) do
    data = for value <- values, into: <<>>, do: <<value::little-16>>
    DepthImage.new!(width: 8, height: 6, data: data, semantics: semantics)
  end

  property "the cloud equals the camera's own projection of each pixel" do
    forall {values, semantics} <- {list(integer(0, 5_000), 48), one_of([:plane, :point])} do
      depth = depth(values, semantics)
      {:ok, cloud} = Depth.to_cloud(depth, @camera)

      expected =
        for {value, i} <- Enum.with_index(values), value > 0 do
          {:ok, point} =
            Camera.unproject(@camera, {rem(i, 8), div(i, 8)}, value / 1000, semantics: semantics)

          point
        end

      found = PointCloud.to_points(cloud)
      assert length(found) == length(expected)
      for {a, b} <- Enum.zip(found, expected), do: assert(Vector3.distance(a, b) < 1.0e-4)

      {:ok, mesh} = Depth.to_mesh(depth, @camera, edge: 1)
      assert Mesh.vertex_count(mesh) == length(expected)

      for {{a, _, _}, {b, _, _}, {c, _, _}} <- Mesh.list_triangles(mesh),
          semantics == :plane,
          do: assert(Enum.max([a, b, c]) - Enum.min([a, b, c]) <= 1.0001)
    end
  end

  test "a table serves many images and rejects an image of another size" do
    {:ok, table} = RayTable.new(@camera)
    depth = depth(List.duplicate(1_000, 48))
    assert Depth.to_cloud(depth, table) == Depth.to_cloud(depth, @camera)
    assert {:ok, sparse} = Depth.to_cloud(depth, table, sparsity: 2)
    assert PointCloud.point_count(sparse) == 12
    assert {:ok, robust} = Depth.to_cloud(depth, table, robust: true)
    assert PointCloud.point_count(robust) == 24

    small = DepthImage.new!(width: 1, height: 1, data: <<1, 1>>)
    assert {:error, %{code: :bad_camera, what: what}} = Depth.to_cloud(small, table)
    assert what == "the table has 48 pixels, the depth image 1"
    assert {:error, %{code: :unknown_option}} = Depth.to_cloud(depth, table, sparse: 2)
    assert {:error, %{code: :bad_depth}} = Depth.to_cloud(%{depth | height: 7}, table)
  end

  test "a ray stops at the wall that the camera saw" do
    camera = CameraIntrinsics.new!(width: 8, height: 6, focal: {4, 4})
    pose = Pose.new({1.0, 0.0, 0.0})
    view = CameraView.new(depth(List.duplicate(2_000, 48)), camera, pose)
    {:ok, ray} = Ray3.new({1.0, 0.2, 0.1}, {1.0, 0.0, 0.0})
    assert {x, y, _} = Depth.intersect_ray(view, ray, step: 0.01)
    assert_in_delta x, 3.0, 0.02
    assert_in_delta y, 0.2, 1.0e-9

    {:ok, away} = Ray3.new({1.0, 0.0, 0.0}, {-1.0, 0.0, 0.0})
    assert Depth.intersect_ray(view, away) == nil
  end
end

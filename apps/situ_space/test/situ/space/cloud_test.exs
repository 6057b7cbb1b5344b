defmodule Situ.Space.CloudTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.{Box3, PointCloud, Pose, Quaternion, Vector3}
  alias Situ.Space.Cloud

  doctest Cloud

  test "values stay with their points" do
    points = for x <- 0..9, do: {x * 1.0, 0.0, 0.0}
    values = for x <- 0..9, into: <<>>, do: <<x * 10.0::little-float-32>>
    {:ok, cloud} = PointCloud.new(PointCloud.from_points(points).points, nil, values)
    numbers = fn %{values: bytes} -> for <<x::little-float-32 <- bytes>>, do: x end
    {:ok, few} = Cloud.limit_points(cloud, 2)
    assert numbers.(few) == [0.0, 50.0]
    {:ok, {near, 4}} = Cloud.clip_to_planes(cloud, [{-1.0, 0.0, 0.0, 3.0}], 2)
    assert numbers.(near) == [0.0, 20.0]
    {:ok, part} = Cloud.clip(cloud, Situ.Box3.new!({4.5, -1.0, -1.0}, {6.5, 1.0, 1.0}))
    assert numbers.(part) == [50.0, 60.0]
    {:ok, [all]} = Cloud.find_clusters(cloud, 1.5)
    assert {:ok, %{values: ^values}} = Cloud.transform(all, Situ.Pose.new({1.0, 0.0, 0.0}))
  end

  defp coordinate, do: map(integer(-300, 300), &(&1 / 100))
  defp points, do: list({coordinate(), coordinate(), coordinate()})

  # The points as 32-bit floats represent them.
  defp cloud(points), do: PointCloud.from_points(points)

  property "a voxel's point is the mean of the points in it" do
    forall {points, tenths} <- {points(), integer(1, 20)} do
      size = tenths / 10
      cloud = cloud(points)
      {:ok, fewer} = Cloud.downsample(cloud, size)

      # The slow reference, with sizes in the precision of the kernel.
      <<size32::little-float-32>> = <<size::little-float-32>>
      key = fn {x, y, z} -> {floor(x / size32), floor(y / size32), floor(z / size32)} end
      groups = cloud |> PointCloud.to_points() |> Enum.group_by(key) |> Map.values()

      means =
        for group <- groups,
            do: group |> Enum.reduce(&Vector3.add/2) |> Vector3.scale(1 / length(group))

      found = PointCloud.to_points(fewer)
      assert length(found) == length(means)
      for mean <- means, do: assert(Enum.any?(found, &(Vector3.distance(&1, mean) < 1.0e-4)))
    end
  end

  property "clipping and transforming agree with the shapes' own functions" do
    forall {points, yaw, size} <- {points(), coordinate(), integer(1, 30)} do
      pose = Pose.new({0.5, -0.5, 0.2}, Quaternion.from_euler(yaw, 0.3, 0))
      {:ok, moved} = Cloud.transform(cloud(points), pose)

      for {a, b} <-
            Enum.zip(
              PointCloud.to_points(moved),
              PointCloud.to_points(PointCloud.transform(cloud(points), pose))
            ),
          do: assert(Vector3.distance(a, b) < 1.0e-4)

      half = size / 10
      box = Box3.new!({-half, -half, -half}, {half, half, half}, pose)
      {:ok, inside} = Cloud.clip(cloud(points), box)

      certain =
        Enum.filter(PointCloud.to_points(cloud(points)), &Box3.contains_point?(box, &1, -1.0e-4))

      assert certain -- PointCloud.to_points(inside) == []

      for point <- PointCloud.to_points(inside),
          do: assert(Box3.contains_point?(box, point, 1.0e-4))
    end
  end

  property "clusters are the groups of touching points" do
    forall points <- points() do
      cloud = cloud(points)
      {:ok, clusters} = Cloud.find_clusters(cloud, 0.8)
      groups = Enum.map(clusters, &Enum.sort(PointCloud.to_points(&1)))
      assert groups |> Enum.concat() |> Enum.sort() == Enum.sort(PointCloud.to_points(cloud))
      assert Enum.map(groups, &length/1) == Enum.sort(Enum.map(groups, &length/1), :desc)

      for {a, i} <- Enum.with_index(groups),
          {b, j} <- Enum.with_index(groups),
          i < j,
          p <- a,
          q <- b,
          do: assert(Vector3.distance(p, q) > 0.8 - 1.0e-4)
    end
  end

  property "any bytes are rejected or computed, and nothing raises" do
    forall {bytes, number} <- {binary(), integer(-5, 5)} do
      cloud = %PointCloud{points: bytes}

      for call <- [
            &Cloud.downsample(&1, number / 2),
            &Cloud.find_clusters(&1, number / 2),
            &Cloud.estimate_normals(&1, number / 2),
            &Cloud.fit_plane(&1, tolerance: number / 2),
            &Cloud.transform(&1, Pose.identity())
          ] do
        assert elem(call.(cloud), 0) in [:ok, :error]
      end
    end
  end

  test "a floor faces its viewer, and colors stay with their points" do
    floor = for x <- 0..9, y <- 0..9, do: {x / 10, y / 10, 0.0}
    {:ok, {normals, curvatures}} = Cloud.estimate_normals(cloud(floor), 0.15, {0.0, 0.0, 2.0})
    for {_, _, z} <- PointCloud.to_points(%PointCloud{points: normals}), do: assert(z > 0.999)
    assert byte_size(curvatures) == 400

    {:ok, colored} =
      PointCloud.new(cloud([{0.0, 0.0, 0.0}, {2.0, 0.0, 0.0}]).points, <<1, 1, 1, 2, 2, 2>>)

    {:ok, part} = Cloud.clip(colored, Box3.new!({1.0, -1.0, -1.0}, {3.0, 1.0, 1.0}))
    assert {PointCloud.to_points(part), part.colors} == {[{2.0, 0.0, 0.0}], <<2, 2, 2>>}
  end

  test "finds the point nearest to a ray" do
    {:ok, ray} = Situ.Ray3.new({0.0, 0.0, 0.0}, {1.0, 0.0, 0.0})

    assert {{5.0, 0.5, 0.0}, 0.5} =
             Cloud.nearest_to_ray(cloud([{1.0, 1.0, 0.0}, {5.0, 0.5, 0.0}]), ray)

    assert Cloud.nearest_to_ray(cloud([]), ray) == nil
  end
end

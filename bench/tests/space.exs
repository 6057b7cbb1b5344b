defmodule Situ.Bench.Space do
  @moduledoc """
  Spatial kernels and the data of a 3D panel, called from Elixir in sequence: operations per
  second by the wall clock, and `_cpu` in microseconds per operation.
  """
  alias Situ.{Bench, CameraIntrinsics, DepthImage, PointCloud, Pose}
  alias Situ.Space.{Cloud, Depth, FrameTree, RayTable, SyntheticRoom}
  alias Situ.Studio.Scene

  def tests, do: [{"space", &space/1}]

  defp space(scale) do
    Enum.flat_map(jobs(), fn {name, n, job} ->
      n = max(round(n * scale), 3)

      Bench.measure(name, n, "op/s", fn ->
        unless Enum.all?(1..n, fn _ -> job.() end), do: raise("#{name}: wrong result")
      end)
    end)
  end

  defp jobs do
    intrinsics = SyntheticRoom.camera_intrinsics(640, 480)
    {:ok, table} = RayTable.new(intrinsics)
    scene = SyntheticRoom.Scene.state_at(1.0)
    {:ok, {depth, color}} = SyntheticRoom.render_views(scene, intrinsics, table)
    {:ok, cloud} = Depth.to_cloud(depth.viewed, table)
    frames = tree()
    million = million()
    ten = %PointCloud{points: :binary.copy(<<0::96>>, 10_000_000)}
    whole = PointCloud.point_count(cloud)

    [
      {"synthetic-room-640x480", 20,
       fn -> match?({:ok, _}, SyntheticRoom.render_views(scene, intrinsics, table)) end},
      {"cloud-from-depth", 60, fn -> whole == count(Depth.to_cloud(depth.viewed, table)) end},
      {"cloud-from-depth-colored", 60,
       fn -> whole == count(Depth.to_cloud(depth.viewed, table, colors: color.viewed)) end},
      {"voxel-downsample", 20, fn -> count(Cloud.downsample(cloud, 0.05)) in 1_000..whole end},
      {"transform-lookup", 100_000,
       fn -> match?({:ok, _}, FrameTree.lookup(frames, "hand", "room", 505_000_000)) end},
      {"3d-upload-1M", 10, fn -> size(million) > 12_000_000 end},
      {"3d-upload-10M-budget-1M", 10, fn -> size(ten) in 12_000_000..13_000_000 end}
    ]
  end

  @doc "Lists the jobs that Python runs as well (`kernels-beside-python`), on the same depth image and tree."
  def beside do
    camera =
      CameraIntrinsics.new!(width: 640, height: 480, focal: {525, 525}, principal: {319.5, 239.5})

    {:ok, table} = RayTable.new(camera)

    data =
      for y <- 0..479,
          x <- 0..639,
          into: <<>>,
          do: <<800 + rem(x * 7 + y * 13, 2_000)::little-16>>

    {:ok, depth} = DepthImage.new(width: 640, height: 480, data: data)
    {:ok, cloud} = Depth.to_cloud(depth, table)
    million = million()

    [
      {"cloud_from_depth", 60, fn -> 307_200 == count(Depth.to_cloud(depth, table)) end},
      {"voxel_downsample", 20, fn -> count(Cloud.downsample(cloud, 0.05)) in 1_000..307_200 end},
      {"transform_lookup_x1000", 20, lookups(tree())},
      {"3d_upload_1M", 10, fn -> byte_size(joined(million)) > 12_000_000 end}
    ]
  end

  defp lookups(frames) do
    fn ->
      Enum.all?(0..999, fn i ->
        match?({:ok, _}, FrameTree.lookup(frames, "hand", "room", 5_000_000 + i * 990_000))
      end)
    end
  end

  # Joined to one binary, as in NumPy. A socket would accept the separate parts.
  defp joined(cloud) do
    {items, []} = Scene.TermItems.collect_items(cloud)
    items |> Scene.pack() |> IO.iodata_to_binary()
  end

  defp million, do: %PointCloud{points: :binary.copy(<<0::96>>, 1_000_000)}

  defp count({:ok, cloud}), do: PointCloud.point_count(cloud)

  defp size(cloud) do
    {items, []} = Scene.TermItems.collect_items(cloud)
    items |> Scene.pack() |> IO.iodata_length()
  end

  # A hand on a moving arm, which is on a moving body.
  defp tree do
    {:ok, frames} =
      FrameTree.put_static(FrameTree.new(), "hand", "arm", Pose.new({0.3, 0.0, 0.0}))

    Enum.reduce(0..100, frames, fn i, frames ->
      turn = Situ.Quaternion.from_euler(i / 50, 0, 0)

      {:ok, frames} =
        FrameTree.put_moving(
          frames,
          "arm",
          "body",
          i * 10_000_000,
          Pose.new({0.0, 0.0, 1.0}, turn)
        )

      {:ok, frames} =
        FrameTree.put_moving(frames, "body", "room", i * 10_000_000, Pose.new({i / 10, 0.0, 0.0}))

      frames
    end)
  end
end

defmodule Situ.Space.DepthCamera.DeviceTest do
  # A device that FFmpeg computes replaces a camera's node: the program, pixels and code path are the same.
  use ExUnit.Case, async: true
  alias Situ.{CameraIntrinsics, CameraView, DepthImage, PointCloud, Pose}
  alias Situ.Space.DepthCamera

  @moduletag :capture_log
  # 1,000 in the first column, and 10 more in each following column.
  @ramp "lavfi:nullsrc=size=32x24:rate=50,format=gray16le,geq=lum='1000+10*X'"

  defp lens(width \\ 32),
    do: CameraIntrinsics.new!(width: width, height: 24, focal: {30, 30}, principal: {16, 12})

  test "emits depth and color as views with the device's values" do
    pose = Pose.new({0.0, 0.0, 2.0})

    opts = [
      device: @ramp,
      color: "lavfi:color=red:size=32x24:rate=50",
      intrinsics: lens(),
      pose: pose,
      scale: 0.0005
    ]

    me = self()

    {:ok, pipeline} =
      Situ.Pipeline.start(fn p ->
        camera = DepthCamera.open(p, {DepthCamera.Device, opts})
        Situ.each(camera.depth, &send(me, {:depth, &1}))
        Situ.each(camera.color, &send(me, {:color, &1}))
      end)

    assert_receive {:depth, view}
    assert_receive {:color, color}
    Situ.Pipeline.stop(pipeline)
    assert %CameraView{viewed: seen, pose: ^pose} = view
    assert {:ok, near} = DepthImage.fetch_distance(seen, 0, 5)
    assert {:ok, far} = DepthImage.fetch_distance(seen, 31, 5)
    assert_in_delta near, 0.5, 1.0e-9
    assert_in_delta far, 0.655, 1.0e-9
    {:ok, cloud} = DepthCamera.view_to_cloud(view)
    assert PointCloud.point_count(cloud) == 32 * 24
    assert color.viewed.format == :bgr24
  end

  test "an image of another size than the lens is an error that names both" do
    opts = [device: @ramp, intrinsics: lens(64)]

    assert {:error, error} =
             Situ.Pipeline.run(fn p ->
               Situ.each(DepthCamera.open(p, {DepthCamera.Device, opts}).depth, fn _ -> :ok end)
             end)

    assert Exception.message(error) =~ "gives images of 32x24, its intrinsics are for 64x24"
  end

  test "a missing camera is an error" do
    opts = [device: "/dev/video-none", intrinsics: lens()]

    assert {:error, error} =
             Situ.Pipeline.run(fn p ->
               Situ.each(DepthCamera.open(p, {DepthCamera.Device, opts}).depth, fn _ -> :ok end)
             end)

    assert Exception.message(error) =~ "/dev/video-none"
  end
end

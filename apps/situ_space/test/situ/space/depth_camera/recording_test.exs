defmodule Situ.Space.DepthCamera.RecordingTest do
  use ExUnit.Case, async: true
  alias Situ.{CameraIntrinsics, CameraView, DepthImage, Pose, Store}
  alias Situ.Space.DepthCamera
  alias Situ.Space.DepthCamera.Recording

  @moduletag :tmp_dir
  @sensor "/device_0/sensor_0/Depth_0"

  defp lens,
    do: CameraIntrinsics.new!(width: 2, height: 1, focal: {2.0, 2.0}, principal: {0.5, 0.0})

  defp depth do
    pixels = <<1_000::little-16, 2_000::little-16>>
    {:ok, depth} = DepthImage.new(width: 2, height: 1, stride: 4, data: pixels, scale: 0.001)
    depth
  end

  defp recorded(root, streams) do
    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        store = Store.create(p, "r", root)

        for {name, value} <- streams,
            do: p |> Situ.from_enumerable([{5, value}]) |> Store.write(store, name)
      end)

    Path.join(root, "r.0000")
  end

  defp points(opts) do
    [cloud] =
      Situ.to_list(fn p -> p |> DepthCamera.open({Recording, opts}) |> DepthCamera.clouds() end)

    Situ.PointCloud.to_points(cloud)
  end

  test "depth of a RealSense recording has the lens stored in the recording", %{tmp_dir: root} do
    path =
      recorded(root, [
        {@sensor <> "/image/data", depth()},
        {@sensor <> "/info/camera_info", lens()}
      ])

    [view] = Situ.to_list(fn p -> DepthCamera.open(p, {Recording, path: path}).depth end)
    assert %CameraView{viewed: %DepthImage{}, pose: pose} = view
    assert pose == Pose.identity()
    assert view.intrinsics == lens()
    # At one and two meters ahead, left and right of the center.
    assert [{1.0, y1, _}, {2.0, y2, _}] = points(path: path)
    assert y1 > 0 and y2 < 0
  end

  test "accepts another camera pose and a given lens", %{tmp_dir: root} do
    path = recorded(root, [{"Far", depth()}])
    at = Pose.new({10.0, 0.0, 0.0})

    assert [{11.0, _, _}, {12.0, _, _}] =
             points(path: path, depth: "Far", intrinsics: lens(), pose: at)
  end

  test "an error about missing data suggests a fix", %{tmp_dir: root} do
    path = recorded(root, [{"Far", depth()}, {"Lens", %{"K" => 1}}])

    open = fn opts ->
      Situ.to_list(fn p -> DepthCamera.open(p, {Recording, [path: path] ++ opts}).depth end)
    end

    for {opts, code, said} <- [
          {[], :no_such_stream, "depth:"},
          {[depth: "Far"], :no_intrinsics, "lens:"},
          {[depth: "Far", lens: "Lenz"], :no_intrinsics, "does not exist"},
          {[depth: "Far", lens: "Lens"], :no_intrinsics, "instead of intrinsics"}
        ] do
      error = assert_raise Situ.Error, fn -> open.(opts) end
      assert error.code == code
      assert Exception.message(error) =~ said
    end
  end
end

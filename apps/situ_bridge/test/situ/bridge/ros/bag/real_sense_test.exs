defmodule Situ.Bridge.Ros.Bag.RealSenseTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Ros.Bag
  alias Situ.{CameraIntrinsics, DepthImage, Image, Store}

  @moduletag :tmp_dir
  @sensor "/device_0/sensor_0"
  @depth @sensor <> "/Depth_0/image/data"

  @camera_info """
  std_msgs/Header header
  uint32 height
  uint32 width
  string distortion_model
  float64[] D
  float64[9] K
  float64[9] R
  float64[12] P
  ================================================================================
  MSG: std_msgs/Header
  uint32 seq
  time stamp
  string frame_id
  """

  # Topics, types and encodings follow the SDK's documentation.
  defp bag(dir, opts) do
    path = Path.join(dir, "d435.bag")
    grey = fn pixels -> Image.new!(width: 2, height: 1, format: :gray16, data: pixels) end
    depth = grey.(<<1_000::little-16, 2_500::little-16>>)

    info = %{
      "header" => %{"seq" => 0, "stamp" => 0, "frame_id" => "0"},
      "height" => 480,
      "width" => 640,
      "distortion_model" => opts[:lens] || "Inverse Brown Conrady",
      "D" => opts[:bend] || [0.1, 0.2, 0.01, 0.02, 0.3],
      "K" => [385.0, 0.0, 320.0, 0.0, 386.0, 240.0, 0.0, 0.0, 1.0],
      "R" => List.duplicate(0.0, 9),
      "P" => List.duplicate(0.0, 12)
    }

    {:ok, _} =
      Situ.Pipeline.run(fn p ->
        bag = Bag.create(p, path)

        write = fn value, time, topic, opts ->
          p |> Situ.from_enumerable([{time, value}]) |> Bag.write(bag, topic, opts)
        end

        write.(%{"data" => 4}, 0, "/file_version",
          type: "std_msgs/UInt32",
          definition: "uint32 data"
        )

        if unit = opts[:unit],
          do:
            write.(%{"data" => unit}, 0, @sensor <> "/option/Depth_Units/value",
              type: "std_msgs/Float32",
              definition: "float32 data"
            )

        write.(info, 0, @sensor <> "/Depth_0/info/camera_info",
          type: "sensor_msgs/CameraInfo",
          definition: @camera_info
        )

        write.(depth, 33_000_000, @depth, [])
        write.(grey.(<<1, 2, 3, 4>>), 33_000_000, @sensor <> "/Infrared_1/image/data", [])
        write.(depth, 40, "/camera/depth/image_raw", [])
      end)

    path
  end

  defp one(store, topic), do: store |> Store.messages(topic) |> Enum.map(& &1.data) |> hd()

  test "applies the sensor's unit to depth, and leaves other gray images unchanged", %{
    tmp_dir: dir
  } do
    store = Store.open!(bag(dir, unit: 1.0e-4))
    depth = one(store, @depth)
    assert %DepthImage{scale: 0.0001, width: 2, semantics: :plane} = depth
    assert DepthImage.fetch_distance(depth, 1, 0) == {:ok, 0.25}
    assert %Image{format: :gray16} = one(store, @sensor <> "/Infrared_1/image/data")
    assert %Image{format: :gray16} = one(store, "/camera/depth/image_raw")
    assert Enum.find(Store.streams(store), &(&1.name == @depth)).type == {:or, [DepthImage, :map]}
  end

  test "defaults to millimeters if the unit is missing or invalid", %{tmp_dir: dir} do
    for unit <- [nil, 0.0, -1.0, 7.0] do
      assert %DepthImage{scale: 0.001} = one(Store.open!(bag(dir, unit: unit)), @depth)
    end
  end

  test "knows the SDK's lenses, and any lens without distortion", %{tmp_dir: dir} do
    camera = fn opts ->
      dir |> bag(opts) |> Store.open!() |> one(@sensor <> "/Depth_0/info/camera_info")
    end

    assert %CameraIntrinsics{
             focal: {385.0, 386.0},
             principal: {320.0, 240.0},
             tangential: {0.01, 0.02},
             distorts?: false
           } = camera.([])

    assert %CameraIntrinsics{distorts?: true} = camera.(lens: "Brown Conrady")
    assert %CameraIntrinsics{} = camera.(lens: "Kannala Brandt4", bend: [0.0, 0.0, 0.0, 0.0, 0.0])
    # Assuming another lens would be wrong, so the message stays a map.
    assert %{"distortion_model" => "Kannala Brandt4"} = camera.(lens: "Kannala Brandt4")
  end
end

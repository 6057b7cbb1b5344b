defmodule Situ.Bridge.Ros.StandardTypesTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Bridge.Mcap.{Channel, Codec}
  alias Situ.Bridge.Ros.{PointCloud2, Definition, StandardTypes, Wire}
  alias Situ.{AudioBuffer, AudioFormat, CameraIntrinsics, DepthImage, Image, PointCloud, Pose}
  doctest Definition

  # Encodes the value as ROS 1 bytes and decodes it.
  defp there_and_back(value) do
    {:ok, channel} = Channel.new("/x", [encoding: :ros1], value)
    {:ok, bytes} = Channel.encode(channel, value, 5)
    {:ok, message} = Wire.decode(channel.definition, bytes, :ros1)
    {message, StandardTypes.from_message(channel.definition.name, message)}
  end

  test "keeps Situ's types, with their time as a stamp" do
    for value <- [
          Image.new!(width: 2, height: 1, format: :bgr24, data: <<1, 2, 3, 4, 5, 6>>),
          DepthImage.new!(width: 1, height: 2, data: <<1, 0, 2, 0>>),
          PointCloud.from_points([{1.0, 2.0, 3.0}, {-1.0, 0.5, 0.0}]),
          %{PointCloud.from_points([{1.0, 2.0, 3.0}]) | colors: <<10, 20, 30>>},
          %{PointCloud.from_points([{1.0, 2.0, 3.0}]) | values: <<7.5::little-float-32>>},
          %{
            PointCloud.from_points([{1.0, 2.0, 3.0}, {4.0, 5.0, 6.0}])
            | colors: <<1, 2, 3, 4, 5, 6>>,
              values: <<7.5::little-float-32, 8.0::little-float-32>>
          },
          %Pose{position: {1.0, 2.0, 3.0}, rotation: {0.5, 0.5, 0.5, -0.5}},
          CameraIntrinsics.new!(
            width: 640,
            height: 480,
            focal: {500, 501},
            radial: [0.1, -0.2, 0.3],
            tangential: {0.01, 0.02}
          ),
          CameraIntrinsics.new!(
            width: 64,
            height: 48,
            focal: {50, 50},
            radial: [0.1, 0, 0, 0, 0, 0.5]
          )
        ] do
      {message, back} = there_and_back(value)
      assert back == value
      assert message["header"]["stamp"] == 5
    end
  end

  test "keeps the values of sensors and joints, in ROS 1 and in ROS 2" do
    pose = %Pose{position: {1.0, 2.0, 3.0}, rotation: {0.5, 0.5, 0.5, -0.5}}
    {:ok, place} = Situ.GeoPoint.new(46.05, 14.5, height: 300.0, accuracy: {1.0, 2.0, 3.0})
    {:ok, nowhere_high} = Situ.GeoPoint.new(-46.05, 14.5)
    {:ok, joints} = Situ.JointState.new(["a", "b"], [0.5, :nan], [], [1.0, 2.0])
    imu = Situ.ImuReading.new({0.0, 0.1, 9.81}, {0.5, 0.0, -0.5})
    optics = CameraIntrinsics.new!(width: 64, height: 48, focal: {50, 50})

    for value <- [
          imu,
          %{imu | orientation: {0.5, 0.5, -0.5, 0.5}},
          place,
          nowhere_high,
          joints,
          Situ.Transform.new("camera", "robot", pose),
          [Situ.Transform.new("camera", "robot", pose)],
          optics
        ],
        encoding <- [:ros1, :cdr] do
      {:ok, channel} = Channel.new("/x", [encoding: encoding, frame: "base"], value)
      {:ok, bytes} = Channel.encode(channel, value, 7_000_000_005)
      {name, language, text} = channel.schema
      assert String.contains?(name, "/msg/") == (encoding == :cdr)
      spelled = if encoding == :ros1, do: "ros1", else: "cdr"
      {codec, _type, nil} = Codec.new(spelled, {name, language, text}, "/x")
      assert Codec.decode(codec, bytes) == {:ok, value}
      {:ok, map} = Codec.decode(Codec.set_message_mode(codec, :maps), bytes)

      with %{"header" => header} <- map do
        assert header["stamp"] == 7_000_000_005
        unless is_struct(value, Situ.Transform), do: assert(header["frame_id"] == "base")
        assert is_map_key(header, "seq") == (encoding == :ros1)
      end
    end
  end

  test "reads static transforms, a receiver without a fix, and the clock" do
    transform = Situ.Transform.new("camera", "robot", Pose.identity())
    message = StandardTypes.to_message("tf2_msgs/TFMessage", [transform], 5)

    assert [%{static: true, frame: "camera"}] =
             StandardTypes.from_message("tf2_msgs/TFMessage", message, "/tf_static")

    assert [%{static: false}] = StandardTypes.from_message("tf/tfMessage", message, "/tf")

    assert %{"status" => _} =
             StandardTypes.from_message("sensor_msgs/NavSatFix", %{"status" => %{"status" => -1}})

    assert StandardTypes.to_message("rosgraph_msgs/Clock", 12, 5) == %{"clock" => 12}
    assert StandardTypes.from_message("rosgraph_msgs/Clock", %{"clock" => 12}) == 12
  end

  test "writes audio as its bytes" do
    {message, back} = there_and_back(AudioBuffer.from_samples([1, -1], AudioFormat.pcm(16_000)))
    assert message == back and message["data"] == <<1, 0, -1::little-16>>
  end

  test "reads clouds whose points and rows have extra bytes" do
    field = fn name, at -> %{"name" => name, "offset" => at, "datatype" => 7, "count" => 1} end

    point = fn x ->
      <<0::32, x::little-float-32, 0.0::little-float-32, 0.0::little-float-32, 9, 8, 7, 0>>
    end

    fields = [
      field.("intensity", 0),
      field.("x", 4),
      field.("y", 8),
      field.("z", 12),
      field.("rgb", 16)
    ]

    message = %{
      "is_bigendian" => false,
      "point_step" => 20,
      "row_step" => 24,
      "width" => 1,
      "height" => 2,
      "fields" => fields,
      "data" => point.(1.0) <> <<0::32>> <> point.(2.0) <> <<0::32>>
    }

    assert {:ok, cloud} = PointCloud2.from_message(message)
    assert PointCloud.to_points(cloud) == [{1.0, 0.0, 0.0}, {2.0, 0.0, 0.0}]
    assert cloud.colors == <<7, 8, 9, 7, 8, 9>>
    assert PointCloud2.from_message(%{message | "data" => "short"}) == :error
    assert PointCloud2.from_message(%{message | "fields" => tl(tl(fields))}) == :error
  end

  test "leaves inconsistent messages as maps" do
    pose = %{
      "position" => %{"x" => 0.0, "y" => 0.0, "z" => 0.0},
      "orientation" => %{"x" => 0.0, "y" => 0.0, "z" => 0.0, "w" => 0.0}
    }

    assert StandardTypes.from_message("geometry_msgs/Pose", pose) == pose

    info = %{
      "width" => 1,
      "height" => 1,
      "K" => List.duplicate(0.0, 9),
      "D" => [],
      "distortion_model" => ""
    }

    assert StandardTypes.from_message("sensor_msgs/CameraInfo", info) == info
    assert StandardTypes.from_message("sensor_msgs/PointCloud2", %{}) == %{}
  end

  test "leaves messages as maps if a standard name has other fields" do
    imu = %{"angular_veIocity" => %{"x" => 1.0, "y" => 0.0, "z" => 0.0}, "header" => %{}}
    assert StandardTypes.from_message("sensor_msgs/Imu", imu) == imu

    assert StandardTypes.from_message("sensor_msgs/Imu", %{
             "linear_acceleration" => 5,
             "angular_velocity" => 6
           })

    for name <-
          ~w(sensor_msgs/NavSatFix sensor_msgs/JointState sensor_msgs/Image tf2_msgs/TFMessage) do
      for message <- [
            %{"transforms" => 5},
            %{"latitude" => "north"},
            %{"name" => 1},
            %{"width" => nil}
          ],
          do: assert(StandardTypes.from_message(name, message) == message)
    end

    transform = %{"translation" => %{}, "child_frame_id" => nil, "parent_frame_id" => 7}
    name = "foxglove.FrameTransform"
    assert Situ.Bridge.Foxglove.StandardTypes.from_message(name, transform) == transform
  end
end

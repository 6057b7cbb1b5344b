defmodule Situ.Bridge.Ros2.TypeHashTest do
  use ExUnit.Case, async: true
  alias Situ.Bridge.Ros.{Definition, Library}
  alias Situ.Bridge.Ros2.TypeHash
  doctest TypeHash

  # Computed by rosbags 0.11.9.
  @theirs %{
    "std_msgs/Bool" => "feb91e995ff9ebd09c0cb3d2aed18b11077585839fb5db80193b62d74528f6c9",
    "std_msgs/Empty" => "20b625256f32d5dbc0d04fee44f43c41e51c70d3502f84b4a08e7a9c26a96312",
    "diagnostic_msgs/DiagnosticStatus" =>
      "b0e3e692ea2d54a8af2f4ef1930e81556a2db55216b771f8a7d2724ed47bf0e4",
    "sensor_msgs/Imu" => "7d9a00ff131080897a5ec7e26e315954b8eae3353c3f995c55faf71574000b5b",
    "sensor_msgs/PointCloud2" =>
      "9198cabf7da3796ae6fe19c4cb3bdd3525492988c70522628af5daa124bae2b5",
    "shape_msgs/SolidPrimitive" =>
      "2802a15190aadc3f496584df4b0b4c5824d8a0b31aaef839faa75bc34dda38ac",
    "tf2_msgs/TFMessage" => "e369d0f05a23ae52508854b66f6aa0437f3449d652e8cbf22d5abe85d020f087",
    "sensor_msgs/CameraInfo" =>
      "b3dfd68ff46c9d56c80fd3bd4ed22c7a4ddce8c8348f2f59c299e73118e7e275",
    "geometry_msgs/PoseWithCovarianceStamped" =>
      "26432f9803e43727d3c8f668d1fdb3c630f548af631e2f4e31382371bfea3b6e"
  }

  test "computes ROS 2's hashes for lists, arrays, bounds and nested types" do
    for {name, sum} <- @theirs do
      {:ok, text} = Library.fetch(name, :ros2)
      {:ok, definition} = Definition.parse(name, text, :ros2)
      assert {name, TypeHash.hash_definition(definition)} == {name, "RIHS01_" <> sum}
    end
  end

  test "gives an empty service request one member" do
    {:ok, service} =
      Definition.parse_service("std_srvs/srv/Trigger", "---\nbool success\nstring message", :ros2)

    # Computed by zenoh-ros2-sdk 0.1.8, and equal to ROS 2 field by field.
    assert TypeHash.hash_service("std_srvs/Trigger", service) ==
             "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f"

    assert [{_, :uint8}] = service.request.types["std_srvs/Trigger_Request"].fields
  end
end

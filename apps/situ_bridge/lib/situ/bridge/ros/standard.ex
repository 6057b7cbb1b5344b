defmodule Situ.Bridge.Ros.Standard do
  @moduledoc """
  The messages of ROS that Situ has types for, both ways; of their headers the stamp goes on as the time. All others
  (`Imu`, `NavSatFix`, `JointState`, tf ...) stay maps.

  | ROS | Situ |
  |---|---|
  | `sensor_msgs/Image` (`mono8`, `mono16`, `rgb8`, `bgr8`, `rgba8`, `bgra8`, `8UC1`, `8UC3`, `16UC1`) | `Situ.Image`; `16UC1` is a `Situ.DepthImage` in millimetres |
  | `sensor_msgs/CompressedImage` (JPEG, PNG) | `Situ.EncodedImage` |
  | `sensor_msgs/PointCloud2` (x, y, z and rgb of it) | `Situ.PointCloud` |
  | `sensor_msgs/CameraInfo` | `Situ.CameraIntrinsics` |
  | `geometry_msgs/Pose`, `PoseStamped` | `Situ.Pose` |
  | `audio_common_msgs/AudioData` | only out, of `Situ.AudioBuffer`: it does not say what its bytes are |
  | `geometry_msgs/Point`, `Point32`, `Vector3` | `Situ.Point3` |
  | `std_msgs/String`, `Bool`, `Int8` ... `Float64` | the value |
  """
  alias Situ.Bridge.Ros.{Cloud, Optics}

  alias Situ.{
    AudioBuffer,
    CameraIntrinsics,
    DepthImage,
    EncodedImage,
    Image,
    Point3,
    PointCloud,
    Pose
  }

  @encodings %{
    "mono8" => :gray8,
    "8UC1" => :gray8,
    "mono16" => :gray16,
    "rgb8" => :rgb24,
    "bgr8" => :bgr24,
    "8UC3" => :bgr24,
    "rgba8" => :rgba32,
    "bgra8" => :bgra32
  }
  @formats %{
    gray8: "mono8",
    gray16: "mono16",
    rgb24: "rgb8",
    bgr24: "bgr8",
    rgba32: "rgba8",
    bgra32: "bgra8"
  }
  @numbers for n <-
                 ~w(Bool String Int8 Int16 Int32 Int64 UInt8 UInt16 UInt32 UInt64 Float32 Float64),
               do: "std_msgs/" <> n
  @points ["geometry_msgs/Point", "geometry_msgs/Point32", "geometry_msgs/Vector3"]

  @poses ["geometry_msgs/Pose", "geometry_msgs/PoseStamped"]

  @doc "The `Situ.Type` that messages of a ROS type become."
  @spec type(String.t()) :: Situ.Type.t()
  def type("sensor_msgs/Image"), do: {:or, [Image, DepthImage, :map]}
  def type("sensor_msgs/CompressedImage"), do: {:or, [EncodedImage, :map]}
  def type("sensor_msgs/PointCloud2"), do: {:or, [PointCloud, :map]}
  def type("sensor_msgs/CameraInfo"), do: {:or, [CameraIntrinsics, :map]}
  def type(pose) when pose in @poses, do: {:or, [Pose, :map]}
  def type(point) when point in @points, do: Point3
  def type("std_msgs/String"), do: :string
  def type("std_msgs/Bool"), do: :boolean
  def type("std_msgs/Float" <> _), do: :float
  def type(number) when number in @numbers, do: :integer
  def type(_), do: :map

  @doc "A message as a struct of Situ; one with impossible values stays a map."
  @spec from(String.t(), map()) :: term()
  def from(name, message) do
    case make(name, message) do
      {:ok, value} -> value
      _ -> message
    end
  end

  defp make("sensor_msgs/Image", %{"encoding" => "16UC1", "is_bigendian" => 0} = m),
    do: DepthImage.new(width: m["width"], height: m["height"], stride: m["step"], data: m["data"])

  defp make("sensor_msgs/Image", m) do
    case {@encodings[m["encoding"]], m["is_bigendian"]} do
      {nil, _} ->
        :error

      {:gray16, 1} ->
        :error

      {format, _} ->
        Image.new(
          width: m["width"],
          height: m["height"],
          stride: m["step"],
          format: format,
          data: m["data"]
        )
    end
  end

  defp make("sensor_msgs/CompressedImage", %{"data" => data}) do
    with {:ok, format} <- EncodedImage.sniff(data),
         do: EncodedImage.new(format: format, data: data)
  end

  defp make("sensor_msgs/PointCloud2", m), do: Cloud.from(m)
  defp make("sensor_msgs/CameraInfo", m), do: Optics.from(m)
  defp make("geometry_msgs/PoseStamped", %{"pose" => pose}), do: make("geometry_msgs/Pose", pose)

  defp make("geometry_msgs/Pose", %{"position" => p, "orientation" => q}) do
    numbers = [p["x"], p["y"], p["z"], q["w"], q["x"], q["y"], q["z"]]

    with true <- Enum.all?(numbers, &is_float/1), [x, y, z, w, i, j, k] = numbers do
      # A rotation of no length is none.
      if Enum.any?([w, i, j, k], &(&1 != 0.0)),
        do: {:ok, %Pose{position: {x, y, z}, rotation: {w, i, j, k}}},
        else: :error
    end
  end

  defp make(point, %{"x" => x, "y" => y, "z" => z})
       when point in @points and is_float(x) and is_float(y) and is_float(z),
       do: {:ok, %Point3{x: x, y: y, z: z}}

  defp make(number, %{"data" => value}) when number in @numbers, do: {:ok, value}
  defp make(_name, _message), do: :error

  @doc "The ROS type that fits data, or `nil`."
  @spec ros_type(term()) :: String.t() | nil
  def ros_type(%Image{format: format}) when is_map_key(@formats, format), do: "sensor_msgs/Image"
  def ros_type(%DepthImage{}), do: "sensor_msgs/Image"
  def ros_type(%EncodedImage{}), do: "sensor_msgs/CompressedImage"
  def ros_type(%Point3{}), do: "geometry_msgs/Point"
  def ros_type(%PointCloud{}), do: "sensor_msgs/PointCloud2"
  def ros_type(%CameraIntrinsics{}), do: "sensor_msgs/CameraInfo"
  def ros_type(%Pose{}), do: "geometry_msgs/PoseStamped"
  def ros_type(%AudioBuffer{}), do: "audio_common_msgs/AudioData"
  def ros_type(text) when is_binary(text), do: "std_msgs/String"
  def ros_type(b) when is_boolean(b), do: "std_msgs/Bool"
  def ros_type(n) when is_integer(n), do: "std_msgs/Int64"

  def ros_type(x) when is_float(x) or x in [:nan, :infinity, :neg_infinity],
    do: "std_msgs/Float64"

  def ros_type(_), do: nil

  @doc "Data as a message of a ROS type: Situ's types become ROS's with `time` as their stamp, maps stay."
  @spec to(String.t(), term(), Situ.Time.t()) :: map()
  def to(_name, %Image{} = image, time) do
    %{
      "width" => image.width,
      "height" => image.height,
      "step" => image.stride,
      "encoding" => @formats[image.format],
      "data" => image.data
    }
    |> stamped(time)
  end

  def to(_name, %DepthImage{} = depth, time) do
    %{
      "width" => depth.width,
      "height" => depth.height,
      "step" => depth.stride,
      "encoding" => "16UC1",
      "data" => depth.data
    }
    |> stamped(time)
  end

  def to(_name, %EncodedImage{} = image, time),
    do: stamped(%{"format" => Atom.to_string(image.format), "data" => image.data}, time)

  def to(_name, %Point3{x: x, y: y, z: z}, _time), do: %{"x" => x, "y" => y, "z" => z}
  def to(_name, %PointCloud{} = cloud, time), do: cloud |> Cloud.to() |> stamped(time)
  def to(_name, %CameraIntrinsics{} = optics, time), do: optics |> Optics.to() |> stamped(time)
  def to(_name, %AudioBuffer{data: data}, _time), do: %{"data" => data}

  def to("geometry_msgs/PoseStamped", %Pose{} = pose, time),
    do: stamped(%{"pose" => pose(pose)}, time)

  def to(_name, %Pose{} = pose, _time), do: pose(pose)
  def to(_name, map, _time) when is_map(map), do: map
  def to(_name, value, _time), do: %{"data" => value}

  defp pose(%Pose{position: {x, y, z}, rotation: {w, i, j, k}}) do
    %{
      "position" => %{"x" => x, "y" => y, "z" => z},
      "orientation" => %{"x" => i, "y" => j, "z" => k, "w" => w}
    }
  end

  defp stamped(message, time), do: Map.put(message, "header", %{"stamp" => max(time, 0)})
end

defmodule Situ.Bridge.Ros.StandardTypes do
  @moduledoc false
  # Converts between ROS messages and Situ's types. The documentation of `Situ.Bridge.Ros` lists the types.
  alias Situ.Bridge.Format.SafeConversion
  alias Situ.Bridge.Ros.{PointCloud2, CameraInfo, Pixels, Sensors}

  alias Situ.{
    AudioBuffer,
    CameraIntrinsics,
    DepthImage,
    EncodedImage,
    GeoPoint,
    Image,
    ImuReading,
    JointState,
    Point3,
    PointCloud,
    Pose,
    Transform
  }

  @numbers for n <-
                 ~w(Bool String Int8 Int16 Int32 Int64 UInt8 UInt16 UInt32 UInt64 Float32 Float64),
               do: "std_msgs/" <> n
  @points ["geometry_msgs/Point", "geometry_msgs/Point32", "geometry_msgs/Vector3"]

  @poses ["geometry_msgs/Pose", "geometry_msgs/PoseStamped"]

  @trees ["tf/tfMessage", "tf2_msgs/TFMessage"]

  @doc "Returns the `Situ.Type` of converted messages of a ROS type."
  @spec situ_type(String.t()) :: Situ.Type.t()
  def situ_type("sensor_msgs/Image"), do: {:or, [Image, DepthImage, :map]}
  def situ_type("sensor_msgs/CompressedImage"), do: {:or, [EncodedImage, :map]}
  def situ_type("sensor_msgs/PointCloud2"), do: {:or, [PointCloud, :map]}
  def situ_type("sensor_msgs/CameraInfo"), do: {:or, [CameraIntrinsics, :map]}
  def situ_type("sensor_msgs/Imu"), do: {:or, [ImuReading, :map]}
  def situ_type("sensor_msgs/NavSatFix"), do: {:or, [GeoPoint, :map]}
  def situ_type("sensor_msgs/JointState"), do: {:or, [JointState, :map]}
  def situ_type("geometry_msgs/TransformStamped"), do: {:or, [Transform, :map]}
  def situ_type(tree) when tree in @trees, do: {:or, [{:list, Transform}, :map]}
  def situ_type("rosgraph_msgs/Clock"), do: :integer
  def situ_type(pose) when pose in @poses, do: {:or, [Pose, :map]}
  def situ_type(point) when point in @points, do: Point3
  def situ_type("std_msgs/String"), do: :string
  def situ_type("std_msgs/Bool"), do: :boolean
  def situ_type("std_msgs/Float" <> _), do: :float
  def situ_type(number) when number in @numbers, do: :integer
  def situ_type(_), do: :map

  @doc """
  Converts a message to a Situ type. Messages with invalid values, or with a standard name but other fields,
  stay maps. Transforms on `/tf_static` are marked as static.
  """
  @spec from_message(String.t(), map(), String.t()) :: term()
  def from_message(name, message, topic \\ "") do
    case SafeConversion.try_build(fn -> build_value(name, message) end) do
      {:ok, value} -> if topic == "/tf_static", do: Sensors.mark_static(value), else: value
      _ -> message
    end
  end

  defp build_value("sensor_msgs/Image", m), do: Pixels.from_message(m, "width", "height", "step")
  defp build_value("sensor_msgs/Imu", m), do: Sensors.parse_imu(m)
  defp build_value("sensor_msgs/NavSatFix", m), do: Sensors.parse_fix(m)
  defp build_value("sensor_msgs/JointState", m), do: Sensors.parse_joints(m)
  defp build_value("geometry_msgs/TransformStamped", m), do: Sensors.parse_transform(m)

  defp build_value(tree, %{"transforms" => list}) when tree in @trees,
    do: Sensors.parse_transforms(list)

  defp build_value("rosgraph_msgs/Clock", %{"clock" => time}), do: {:ok, time}

  defp build_value("sensor_msgs/CompressedImage", %{"data" => data}) do
    with {:ok, format} <- EncodedImage.detect_format(data),
         do: EncodedImage.new(format: format, data: data)
  end

  defp build_value("sensor_msgs/PointCloud2", m), do: PointCloud2.from_message(m)
  defp build_value("sensor_msgs/CameraInfo", m), do: CameraInfo.from_message(m)

  defp build_value("geometry_msgs/PoseStamped", %{"pose" => pose}),
    do: build_value("geometry_msgs/Pose", pose)

  defp build_value("geometry_msgs/Pose", %{"position" => p, "orientation" => q}),
    do: Sensors.parse_pose(p, q)

  defp build_value(point, %{"x" => x, "y" => y, "z" => z})
       when point in @points and is_float(x) and is_float(y) and is_float(z),
       do: {:ok, %Point3{x: x, y: y, z: z}}

  defp build_value(number, %{"data" => value}) when number in @numbers, do: {:ok, value}
  defp build_value(_name, _message), do: :error

  @doc "Returns the ROS type that fits the data, or `nil`."
  @spec ros_type(term()) :: String.t() | nil
  def ros_type(%Image{} = image), do: if(Pixels.encoding_name(image), do: "sensor_msgs/Image")
  def ros_type(%DepthImage{}), do: "sensor_msgs/Image"
  def ros_type(%EncodedImage{}), do: "sensor_msgs/CompressedImage"
  def ros_type(%Point3{}), do: "geometry_msgs/Point"
  def ros_type(%PointCloud{}), do: "sensor_msgs/PointCloud2"
  def ros_type(%CameraIntrinsics{}), do: "sensor_msgs/CameraInfo"
  def ros_type(%Pose{}), do: "geometry_msgs/PoseStamped"
  def ros_type(%ImuReading{}), do: "sensor_msgs/Imu"
  def ros_type(%GeoPoint{}), do: "sensor_msgs/NavSatFix"
  def ros_type(%JointState{}), do: "sensor_msgs/JointState"
  def ros_type(%Transform{}), do: "geometry_msgs/TransformStamped"
  def ros_type([%Transform{} | _]), do: "tf2_msgs/TFMessage"
  def ros_type(%AudioBuffer{}), do: "audio_common_msgs/AudioData"
  def ros_type(text) when is_binary(text), do: "std_msgs/String"
  def ros_type(b) when is_boolean(b), do: "std_msgs/Bool"
  def ros_type(n) when is_integer(n) and n > 0x7FFF_FFFF_FFFF_FFFF, do: "std_msgs/UInt64"
  def ros_type(n) when is_integer(n), do: "std_msgs/Int64"

  def ros_type(x) when is_float(x) or x in [:nan, :infinity, :neg_infinity],
    do: "std_msgs/Float64"

  def ros_type(_), do: nil

  @doc """
  Converts data to a message of a ROS type. Headers get `time` as the stamp and `frame` as the frame of reference. Maps
  are used as they are.
  """
  @spec to_message(String.t(), term(), Situ.Time.t(), String.t()) :: map()
  def to_message(name, data, time, frame \\ "") do
    case build_fields(name, data, time) do
      {:with_header, message} ->
        Map.put(message, "header", %{"stamp" => max(time, 0), "frame_id" => frame})

      message ->
        message
    end
  end

  defp build_fields(_name, %Image{} = image, _time),
    do: {:with_header, Pixels.to_message(image, "step")}

  defp build_fields(_name, %DepthImage{} = depth, _time),
    do: {:with_header, Pixels.to_message(depth, "step")}

  defp build_fields(_name, %EncodedImage{} = image, _time),
    do: {:with_header, %{"format" => Atom.to_string(image.format), "data" => image.data}}

  defp build_fields(_name, %Point3{x: x, y: y, z: z}, _time), do: %{"x" => x, "y" => y, "z" => z}

  defp build_fields(_name, %PointCloud{} = cloud, _time),
    do: {:with_header, PointCloud2.to_message(cloud)}

  defp build_fields(_name, %CameraIntrinsics{} = intrinsics, _time),
    do: {:with_header, CameraInfo.to_message(intrinsics)}

  defp build_fields(_name, %ImuReading{} = imu, _time),
    do: {:with_header, Sensors.to_message(imu)}

  defp build_fields(_name, %GeoPoint{} = location, _time),
    do: {:with_header, Sensors.to_message(location)}

  defp build_fields(_name, %JointState{} = joints, _time),
    do: {:with_header, Sensors.to_message(joints)}

  defp build_fields(tree, %Transform{} = transform, time) when tree in @trees,
    do: build_fields(tree, [transform], time)

  defp build_fields(_name, %Transform{} = transform, time),
    do: Sensors.encode_transform(transform, time)

  defp build_fields(_name, [%Transform{} | _] = list, time),
    do: %{"transforms" => Enum.map(list, &Sensors.encode_transform(&1, time))}

  defp build_fields(_name, %AudioBuffer{data: data}, _time), do: %{"data" => data}

  defp build_fields("geometry_msgs/PoseStamped", %Pose{} = pose, _time),
    do: {:with_header, %{"pose" => Sensors.to_message(pose)}}

  defp build_fields(_name, %Pose{} = pose, _time), do: Sensors.to_message(pose)

  defp build_fields("rosgraph_msgs/Clock", time, _time) when is_integer(time),
    do: %{"clock" => time}

  defp build_fields(_name, map, _time) when is_map(map), do: map
  defp build_fields(_name, value, _time), do: %{"data" => value}
end

defmodule Situ.Bridge.Ros.Standard do
  @moduledoc """
  Converts between ROS messages and Situ's types. The stamp of a message's header becomes its time. Other messages stay
  maps. With `messages: :maps`, a reader returns all messages as maps, including covariances and frames of reference.

  | ROS | Situ |
  |---|---|
  | `sensor_msgs/Image` (`mono8`, `mono16`, `rgb8`, `bgr8`, `rgba8`, `bgra8`, `8UC1`, `8UC3`, `16UC1`) | `Situ.Image`; `16UC1` is a `Situ.DepthImage` in millimeters |
  | `sensor_msgs/CompressedImage` (JPEG, PNG) | `Situ.EncodedImage` |
  | `sensor_msgs/PointCloud2` (x, y, z, rgb and intensity) | `Situ.PointCloud` |
  | `sensor_msgs/CameraInfo` | `Situ.CameraIntrinsics` |
  | `sensor_msgs/Imu` | `Situ.ImuReading` |
  | `sensor_msgs/NavSatFix` | `Situ.GeoPoint`; a map without a fix |
  | `sensor_msgs/JointState` | `Situ.JointState` |
  | `tf2_msgs/TFMessage`, `tf/tfMessage` | a list of `Situ.Transform`, marked as static on `/tf_static` |
  | `geometry_msgs/TransformStamped` | `Situ.Transform` |
  | `geometry_msgs/Pose`, `PoseStamped` | `Situ.Pose` |
  | `audio_common_msgs/AudioData` | written from `Situ.AudioBuffer`; read as a map, because it has no format |
  | `geometry_msgs/Point`, `Point32`, `Vector3` | `Situ.Point3` |
  | `rosgraph_msgs/Clock` | the simulated time, an integer |
  | `std_msgs/String`, `Bool`, `Int8` ... `Float64` | the value |
  """
  alias Situ.Bridge.Format.Fitting
  alias Situ.Bridge.Ros.{Cloud, Optics, Pixels, Sensors}

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
  @spec type(String.t()) :: Situ.Type.t()
  def type("sensor_msgs/Image"), do: {:or, [Image, DepthImage, :map]}
  def type("sensor_msgs/CompressedImage"), do: {:or, [EncodedImage, :map]}
  def type("sensor_msgs/PointCloud2"), do: {:or, [PointCloud, :map]}
  def type("sensor_msgs/CameraInfo"), do: {:or, [CameraIntrinsics, :map]}
  def type("sensor_msgs/Imu"), do: {:or, [ImuReading, :map]}
  def type("sensor_msgs/NavSatFix"), do: {:or, [GeoPoint, :map]}
  def type("sensor_msgs/JointState"), do: {:or, [JointState, :map]}
  def type("geometry_msgs/TransformStamped"), do: {:or, [Transform, :map]}
  def type(tree) when tree in @trees, do: {:or, [{:list, Transform}, :map]}
  def type("rosgraph_msgs/Clock"), do: :integer
  def type(pose) when pose in @poses, do: {:or, [Pose, :map]}
  def type(point) when point in @points, do: Point3
  def type("std_msgs/String"), do: :string
  def type("std_msgs/Bool"), do: :boolean
  def type("std_msgs/Float" <> _), do: :float
  def type(number) when number in @numbers, do: :integer
  def type(_), do: :map

  @doc """
  Converts a message to a Situ type. Messages with invalid values, or with a standard name but other fields,
  stay maps. Transforms on `/tf_static` are marked as static.
  """
  @spec from(String.t(), map(), String.t()) :: term()
  def from(name, message, topic \\ "") do
    case Fitting.try(fn -> make(name, message) end) do
      {:ok, value} -> if topic == "/tf_static", do: Sensors.static(value), else: value
      _ -> message
    end
  end

  defp make("sensor_msgs/Image", m), do: Pixels.from(m, "width", "height", "step")
  defp make("sensor_msgs/Imu", m), do: Sensors.imu(m)
  defp make("sensor_msgs/NavSatFix", m), do: Sensors.fix(m)
  defp make("sensor_msgs/JointState", m), do: Sensors.joints(m)
  defp make("geometry_msgs/TransformStamped", m), do: Sensors.transform(m)
  defp make(tree, %{"transforms" => list}) when tree in @trees, do: Sensors.transforms(list)
  defp make("rosgraph_msgs/Clock", %{"clock" => time}), do: {:ok, time}

  defp make("sensor_msgs/CompressedImage", %{"data" => data}) do
    with {:ok, format} <- EncodedImage.sniff(data),
         do: EncodedImage.new(format: format, data: data)
  end

  defp make("sensor_msgs/PointCloud2", m), do: Cloud.from(m)
  defp make("sensor_msgs/CameraInfo", m), do: Optics.from(m)
  defp make("geometry_msgs/PoseStamped", %{"pose" => pose}), do: make("geometry_msgs/Pose", pose)

  defp make("geometry_msgs/Pose", %{"position" => p, "orientation" => q}), do: Sensors.pose(p, q)

  defp make(point, %{"x" => x, "y" => y, "z" => z})
       when point in @points and is_float(x) and is_float(y) and is_float(z),
       do: {:ok, %Point3{x: x, y: y, z: z}}

  defp make(number, %{"data" => value}) when number in @numbers, do: {:ok, value}
  defp make(_name, _message), do: :error

  @doc "Returns the ROS type that fits the data, or `nil`."
  @spec ros_type(term()) :: String.t() | nil
  def ros_type(%Image{} = image), do: if(Pixels.name(image), do: "sensor_msgs/Image")
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
  def ros_type(n) when is_integer(n), do: "std_msgs/Int64"

  def ros_type(x) when is_float(x) or x in [:nan, :infinity, :neg_infinity],
    do: "std_msgs/Float64"

  def ros_type(_), do: nil

  @doc """
  Converts data to a message of a ROS type. Headers get `time` as the stamp and `frame` as the frame of reference. Maps
  are used as they are.
  """
  @spec to(String.t(), term(), Situ.Time.t(), String.t()) :: map()
  def to(name, data, time, frame \\ "") do
    case plain(name, data, time) do
      {:headed, message} ->
        Map.put(message, "header", %{"stamp" => max(time, 0), "frame_id" => frame})

      message ->
        message
    end
  end

  defp plain(_name, %Image{} = image, _time), do: {:headed, Pixels.to(image, "step")}
  defp plain(_name, %DepthImage{} = depth, _time), do: {:headed, Pixels.to(depth, "step")}

  defp plain(_name, %EncodedImage{} = image, _time),
    do: {:headed, %{"format" => Atom.to_string(image.format), "data" => image.data}}

  defp plain(_name, %Point3{x: x, y: y, z: z}, _time), do: %{"x" => x, "y" => y, "z" => z}
  defp plain(_name, %PointCloud{} = cloud, _time), do: {:headed, Cloud.to(cloud)}
  defp plain(_name, %CameraIntrinsics{} = optics, _time), do: {:headed, Optics.to(optics)}
  defp plain(_name, %ImuReading{} = imu, _time), do: {:headed, Sensors.to(imu)}
  defp plain(_name, %GeoPoint{} = place, _time), do: {:headed, Sensors.to(place)}
  defp plain(_name, %JointState{} = joints, _time), do: {:headed, Sensors.to(joints)}

  defp plain(tree, %Transform{} = transform, time) when tree in @trees,
    do: plain(tree, [transform], time)

  defp plain(_name, %Transform{} = transform, time), do: Sensors.stamped(transform, time)

  defp plain(_name, [%Transform{} | _] = list, time),
    do: %{"transforms" => Enum.map(list, &Sensors.stamped(&1, time))}

  defp plain(_name, %AudioBuffer{data: data}, _time), do: %{"data" => data}

  defp plain("geometry_msgs/PoseStamped", %Pose{} = pose, _time),
    do: {:headed, %{"pose" => Sensors.to(pose)}}

  defp plain(_name, %Pose{} = pose, _time), do: Sensors.to(pose)
  defp plain("rosgraph_msgs/Clock", time, _time) when is_integer(time), do: %{"clock" => time}
  defp plain(_name, map, _time) when is_map(map), do: map
  defp plain(_name, value, _time), do: %{"data" => value}
end

defmodule Situ.Bridge.Foxglove.StandardTypes do
  @moduledoc false
  # Converts between Foxglove's messages and Situ's types. The documentation of `Situ.Bridge.Foxglove` lists the
  # types. Timestamps are written from originating times.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Format.SafeConversion
  alias Situ.Bridge.Ros.{CameraInfo, Pixels, Sensors}

  alias Situ.{
    AudioBuffer,
    AudioFormat,
    CameraIntrinsics,
    DepthImage,
    EncodedImage,
    GeoPoint,
    Image,
    JointState,
    Point3,
    PointCloud,
    Pose,
    Transform,
    VideoPacket
  }

  @package "foxglove."
  @float32 "FLOAT32"
  @colors ~w(red green blue)

  @doc "Returns the `Situ.Type` of the values that messages of a Foxglove type are converted to."
  @spec situ_type(String.t()) :: Situ.Type.t()
  def situ_type(@package <> name), do: package_type(name)
  def situ_type(_), do: :map

  defp package_type("RawImage"), do: {:or, [Image, DepthImage, :map]}
  defp package_type("CompressedImage"), do: {:or, [EncodedImage, :map]}
  defp package_type("PointCloud"), do: {:or, [PointCloud, :map]}
  defp package_type("FrameTransform"), do: {:or, [Transform, :map]}
  defp package_type("FrameTransforms"), do: {:or, [{:list, Transform}, :map]}
  defp package_type(pose) when pose in ["Pose", "PoseInFrame"], do: {:or, [Pose, :map]}
  defp package_type(point) when point in ["Point3", "Vector3"], do: {:or, [Point3, :map]}
  defp package_type("CameraCalibration"), do: {:or, [CameraIntrinsics, :map]}
  defp package_type("LocationFix"), do: {:or, [GeoPoint, :map]}
  defp package_type("JointStates"), do: {:or, [JointState, :map]}
  defp package_type("RawAudio"), do: {:or, [AudioBuffer, :map]}
  defp package_type(_), do: :map

  @doc "Converts a message to Situ's type; an invalid message, or one without a Situ type, stays a map."
  @spec from_message(String.t(), map()) :: term()
  def from_message(@package <> name, message) do
    case SafeConversion.try_build(fn -> build_value(name, message) end) do
      {:ok, value} -> value
      _ -> message
    end
  end

  def from_message(_name, message), do: message

  defp build_value("RawImage", m), do: Pixels.from_message(m, "width", "height", "step")

  defp build_value("CompressedImage", %{"data" => data}) do
    with {:ok, format} <- EncodedImage.detect_format(data),
         do: EncodedImage.new(format: format, data: data)
  end

  defp build_value("PointCloud", m), do: parse_cloud(m)

  defp build_value("FrameTransform", m) do
    with {:ok, pose} <- parse_pose(m["translation"], m["rotation"]),
         do: {:ok, Transform.new(m["child_frame_id"], m["parent_frame_id"], pose)}
  end

  defp build_value("FrameTransforms", %{"transforms" => list}) do
    transforms =
      for m <- list, {:ok, transform} <- [build_value("FrameTransform", m)], do: transform

    if length(transforms) == length(list), do: {:ok, transforms}, else: :error
  end

  defp build_value("PoseInFrame", %{"pose" => %{} = pose}), do: build_value("Pose", pose)
  defp build_value("Pose", m), do: parse_pose(m["position"], m["orientation"])

  defp build_value(point, %{"x" => x, "y" => y, "z" => z})
       when point in ["Point3", "Vector3"] and is_float(x) and is_float(y) and is_float(z),
       do: {:ok, %Point3{x: x, y: y, z: z}}

  defp build_value("CameraCalibration", m), do: CameraInfo.from_message(m)

  defp build_value("LocationFix", m),
    do:
      GeoPoint.new(m["latitude"], m["longitude"],
        height: Sensors.parse_altitude(m),
        accuracy: Sensors.parse_accuracy(m)
      )

  defp build_value("JointStates", %{"joints" => joints}) do
    [names | lists] =
      for key <- ~w(name position velocity effort), do: Enum.map(joints, & &1[key])

    # JointState has a value for each joint or for none: if one joint lacks a value, the list is left out.
    [p, v, e] = for list <- lists, do: if(nil in list, do: [], else: list)
    JointState.new(names, p, v, e)
  end

  defp build_value("RawAudio", %{"format" => "pcm-s16", "data" => data} = m) do
    with {:ok, format} <-
           AudioFormat.new(rate: m["sample_rate"], channels: m["number_of_channels"]),
         do: AudioBuffer.new(format: format, data: data)
  end

  defp build_value(_name, _message), do: :error

  # A missing position is the origin; a missing rotation is the identity.
  defp parse_pose(position, rotation) do
    p = position || %{"x" => 0.0, "y" => 0.0, "z" => 0.0}
    q = rotation || %{"x" => 0.0, "y" => 0.0, "z" => 0.0, "w" => 1.0}

    with [x, y, z, w, i, j, k] = numbers <-
           [p["x"], p["y"], p["z"], q["w"], q["x"], q["y"], q["z"]],
         true <- Enum.all?(numbers, &is_float/1),
         true <- Enum.any?([w, i, j, k], &(&1 != 0.0)),
         do: {:ok, %Pose{position: {x, y, z}, rotation: {w, i, j, k}}},
         else: (_ -> :error)
  end

  defp parse_cloud(%{"point_stride" => step, "fields" => fields, "data" => data, "pose" => pose}) do
    layout = Map.new(fields, &{&1["name"], {&1["offset"], &1["type"]}})

    with true <- identity_pose?(pose) and step > 0 and rem(byte_size(data), step) == 0,
         %{"x" => {x, @float32}, "y" => {y, @float32}, "z" => {z, @float32}} <- layout,
         true <- y == x + 4 and z == x + 8 and x + 12 <= step do
      PointCloud.new(Pixels.slice_every(data, step, x, 12), read_colors(data, step, layout))
    else
      _ -> :error
    end
  end

  # Only clouds with an identity pose are converted: the points of others would have to be transformed first.
  defp identity_pose?(nil), do: true

  defp identity_pose?(m),
    do: parse_pose(m["position"], m["orientation"]) == {:ok, Pose.identity()}

  defp read_colors(data, step, layout) do
    with [r, g, b] <- for(c <- @colors, {o, "UINT8"} <- [layout[c]], o < step, do: o) do
      for <<point::binary-pinned_size(step) <- data>>, into: <<>> do
        <<:binary.at(point, r), :binary.at(point, g), :binary.at(point, b)>>
      end
    else
      _ -> nil
    end
  end

  @doc "Returns the name of the Foxglove type that fits data, or `nil`."
  @spec message_type(term()) :: String.t() | nil
  def message_type(%DepthImage{}), do: @package <> "RawImage"

  def message_type(%Image{} = image),
    do: if(Pixels.encoding_name(image), do: @package <> "RawImage")

  def message_type(%EncodedImage{}), do: @package <> "CompressedImage"
  def message_type(%VideoPacket{}), do: @package <> "CompressedVideo"
  def message_type(%PointCloud{}), do: @package <> "PointCloud"
  def message_type(%Transform{}), do: @package <> "FrameTransform"
  def message_type([%Transform{} | _]), do: @package <> "FrameTransforms"
  def message_type(%Pose{}), do: @package <> "PoseInFrame"
  def message_type(%Point3{}), do: @package <> "Point3"
  def message_type(%CameraIntrinsics{}), do: @package <> "CameraCalibration"
  def message_type(%GeoPoint{}), do: @package <> "LocationFix"
  def message_type(%JointState{}), do: @package <> "JointStates"
  def message_type(%AudioBuffer{format: %{sample: :s16}}), do: @package <> "RawAudio"
  def message_type(text) when is_binary(text), do: @package <> "Log"
  def message_type(_), do: nil

  @doc """
  Converts data to a message of the type `name`. Situ's types become Foxglove's, with `time` as their timestamp and
  `frame` as their frame of reference. Maps and other values are returned unchanged.
  """
  @spec to_message(String.t(), term(), Situ.Time.t(), String.t()) :: term()
  def to_message(name, value, time, frame \\ "")

  def to_message(_name, %Image{} = image, time, frame),
    do: image |> Pixels.to_message("step") |> put_frame(time, frame)

  def to_message(_name, %DepthImage{} = depth, time, frame),
    do: depth |> Pixels.to_message("step") |> put_frame(time, frame)

  def to_message(_name, %EncodedImage{} = image, time, frame),
    do: put_frame(%{"format" => Atom.to_string(image.format), "data" => image.data}, time, frame)

  # Foxglove takes H.264 in the same form: Annex B, with the parameters in every key frame and without B-frames.
  def to_message(_name, %VideoPacket{} = packet, time, frame),
    do: put_frame(%{"format" => Atom.to_string(packet.codec), "data" => packet.data}, time, frame)

  def to_message(_name, %PointCloud{} = cloud, time, frame),
    do: cloud |> encode_cloud() |> put_frame(time, frame)

  def to_message(_name, %Transform{} = transform, time, _frame),
    do: encode_transform(transform, time)

  def to_message(_name, [%Transform{} | _] = list, time, _frame),
    do: %{"transforms" => Enum.map(list, &encode_transform(&1, time))}

  def to_message(@package <> "PoseInFrame", %Pose{} = pose, time, frame),
    do: put_frame(%{"pose" => encode_pose(pose)}, time, frame)

  def to_message(_name, %Pose{} = pose, _time, _frame), do: encode_pose(pose)
  def to_message(_name, %Point3{x: x, y: y, z: z}, _time, _frame), do: encode_vector({x, y, z})

  def to_message(_name, %CameraIntrinsics{} = intrinsics, time, frame),
    do: intrinsics |> CameraInfo.to_message() |> put_frame(time, frame)

  def to_message(_name, %AudioBuffer{format: format, data: data}, time, _frame) do
    %{
      "timestamp" => time,
      "data" => data,
      "format" => "pcm-s16",
      "sample_rate" => format.rate,
      "number_of_channels" => format.channels
    }
  end

  def to_message(_name, %GeoPoint{} = location, time, frame) do
    {covariance, type} = Sensors.encode_covariance(location.accuracy)

    put_frame(
      %{
        "latitude" => location.latitude,
        "longitude" => location.longitude,
        "altitude" => location.height || :nan,
        "position_covariance" => covariance,
        "position_covariance_type" => type
      },
      time,
      frame
    )
  end

  def to_message(_name, %JointState{} = s, time, _frame) do
    lists =
      for list <- [s.positions, s.velocities, s.efforts],
          do: Stream.concat(list, Stream.cycle([nil]))

    joints =
      for {name, p, v, e} <- Enum.zip([s.names | lists]),
          do: %{"name" => name, "position" => p, "velocity" => v, "effort" => e}

    %{"timestamp" => time, "joints" => joints}
  end

  def to_message(@package <> "Log", text, time, _frame) when is_binary(text),
    do: %{"timestamp" => time, "level" => "INFO", "message" => text}

  def to_message(_name, map, _time, _frame), do: map

  defp put_frame(message, time, frame),
    do: Map.merge(message, %{"timestamp" => time, "frame_id" => frame})

  defp encode_transform(%Transform{pose: pose} = t, time) do
    %{"position" => position, "orientation" => rotation} = encode_pose(pose)

    %{
      "timestamp" => time,
      "parent_frame_id" => t.parent,
      "child_frame_id" => t.frame,
      "translation" => position,
      "rotation" => rotation
    }
  end

  defp encode_pose(%Pose{position: position, rotation: {w, i, j, k}}),
    do: %{
      "position" => encode_vector(position),
      "orientation" => Map.put(encode_vector({i, j, k}), "w", w)
    }

  defp encode_vector({x, y, z}), do: %{"x" => x, "y" => y, "z" => z}

  defp encode_cloud(%PointCloud{colors: nil, points: points}),
    do:
      build_cloud(
        12,
        points,
        for({name, i} <- Enum.with_index(~w(x y z)), do: {name, 4 * i, @float32})
      )

  defp encode_cloud(%PointCloud{colors: colors, points: points}) do
    fields = for({name, i} <- Enum.with_index(~w(x y z)), do: {name, 4 * i, @float32})
    color_fields = for({name, i} <- Enum.with_index(@colors), do: {name, 12 + i, "UINT8"})
    build_cloud(16, Pixels.interleave_points(points, colors), fields ++ color_fields)
  end

  defp build_cloud(step, data, fields) do
    fields = for {name, at, type} <- fields, do: %{"name" => name, "offset" => at, "type" => type}

    %{
      "point_stride" => step,
      "fields" => fields,
      "data" => data,
      "pose" => encode_pose(Pose.identity())
    }
  end
end

defmodule Situ.Bridge.Ros.Sensors do
  @moduledoc false
  # Converts ROS messages of inertial sensors, satellite receivers, joints, poses and transforms. Pure.
  alias Situ.{GeoPoint, ImuReading, JointState, Pose, Transform}

  @type result :: {:ok, term()} | {:error, term()} | :error
  @unknown_covariance List.duplicate(0.0, 9)
  @no_rotation {1.0, 0.0, 0.0, 0.0}

  @doc "Converts an Imu. The orientation is nil if its covariance begins with -1 or all its components are zero."
  @spec parse_imu(map()) :: result()
  def parse_imu(%{"linear_acceleration" => a, "angular_velocity" => w} = m) do
    with {:ok, acceleration} <- parse_vector(a), {:ok, velocity} <- parse_vector(w) do
      reading = ImuReading.new(acceleration, velocity)
      {:ok, %{reading | orientation: parse_orientation(m)}}
    end
  end

  defp parse_orientation(%{"orientation_covariance" => [-1.0 | _]}), do: nil

  defp parse_orientation(%{"orientation" => q}) do
    case parse_rotation(q) do
      {:ok, rotation} -> rotation
      :error -> nil
    end
  end

  @doc "Converts a NavSatFix, or returns `:error` if it has no fix."
  @spec parse_fix(map()) :: result()
  def parse_fix(%{"status" => %{"status" => status}} = m) when status >= 0 do
    GeoPoint.new(m["latitude"], m["longitude"],
      height: parse_altitude(m),
      accuracy: parse_accuracy(m)
    )
  end

  def parse_fix(_no_fix), do: :error

  @doc "Returns the altitude, or nil if it is NaN, which means unknown."
  @spec parse_altitude(map()) :: float() | nil
  def parse_altitude(%{"altitude" => altitude}), do: if(is_float(altitude), do: altitude)

  @doc "Returns the standard deviations of the covariance, or nil if it is unknown."
  @spec parse_accuracy(map()) :: Situ.Vector3.t() | nil
  def parse_accuracy(%{"position_covariance" => [e, _, _, _, n, _, _, _, u]} = m)
      when is_float(e) and is_float(n) and is_float(u) and e >= 0 and n >= 0 and u >= 0 do
    if m["position_covariance_type"] in [0, "UNKNOWN"],
      do: nil,
      else: {:math.sqrt(e), :math.sqrt(n), :math.sqrt(u)}
  end

  def parse_accuracy(_m), do: nil

  @doc "Converts a JointState."
  @spec parse_joints(map()) :: result()
  def parse_joints(%{"name" => names, "position" => p, "velocity" => v, "effort" => e}),
    do: JointState.new(names, p, v, e)

  @doc "Converts a TransformStamped."
  @spec parse_transform(map()) :: result()
  def parse_transform(%{"header" => header, "child_frame_id" => frame, "transform" => t}) do
    with {:ok, pose} <- parse_pose(t["translation"], t["rotation"]),
         do: {:ok, Transform.new(frame, header["frame_id"], pose)}
  end

  @doc "Converts the transforms of a TFMessage, or returns `:error` if any of them is invalid."
  @spec parse_transforms([map()]) :: result()
  def parse_transforms(list) do
    transforms = for m <- list, {:ok, transform} <- [parse_transform(m)], do: transform
    if length(transforms) == length(list), do: {:ok, transforms}, else: :error
  end

  @doc "Marks transforms as static, that is, valid at all times."
  @spec mark_static(term()) :: term()
  def mark_static(%Transform{} = transform), do: %{transform | static: true}
  def mark_static(list) when is_list(list), do: Enum.map(list, &mark_static/1)
  def mark_static(other), do: other

  @doc "Converts a position and a rotation, or returns `:error` if the rotation has length zero."
  @spec parse_pose(map(), map()) :: {:ok, Pose.t()} | :error
  def parse_pose(position, rotation) do
    with {:ok, position} <- parse_vector(position),
         {:ok, rotation} <- parse_rotation(rotation),
         do: {:ok, %Pose{position: position, rotation: rotation}}
  end

  defp parse_vector(%{"x" => x, "y" => y, "z" => z})
       when is_float(x) and is_float(y) and is_float(z),
       do: {:ok, {x, y, z}}

  defp parse_vector(_), do: :error

  defp parse_rotation(%{"x" => x, "y" => y, "z" => z, "w" => w})
       when is_float(x) and is_float(y) and is_float(z) and is_float(w) and
              (x != 0.0 or y != 0.0 or z != 0.0 or w != 0.0),
       do: {:ok, {w, x, y, z}}

  defp parse_rotation(_), do: :error

  @doc "Converts a value to the fields of its message."
  @spec to_message(ImuReading.t() | GeoPoint.t() | JointState.t() | Pose.t()) :: map()
  def to_message(%ImuReading{} = imu) do
    %{
      "orientation" => encode_rotation(imu.orientation || @no_rotation),
      "orientation_covariance" =>
        if(imu.orientation, do: @unknown_covariance, else: [-1.0 | tl(@unknown_covariance)]),
      "linear_acceleration" => encode_vector(imu.acceleration),
      "angular_velocity" => encode_vector(imu.angular_velocity)
    }
  end

  def to_message(%GeoPoint{} = location) do
    {covariance, type} = encode_covariance(location.accuracy)

    %{
      "status" => %{"status" => 0, "service" => 1},
      "latitude" => location.latitude,
      "longitude" => location.longitude,
      "altitude" => location.height || :nan,
      "position_covariance" => covariance,
      "position_covariance_type" => type
    }
  end

  def to_message(%JointState{} = joints) do
    %{
      "name" => joints.names,
      "position" => joints.positions,
      "velocity" => joints.velocities,
      "effort" => joints.efforts
    }
  end

  def to_message(%Pose{} = pose),
    do: %{
      "position" => encode_vector(pose.position),
      "orientation" => encode_rotation(pose.rotation)
    }

  @doc "Returns the nine numbers of a covariance matrix and ROS's number for the covariance type."
  @spec encode_covariance(float() | Situ.Vector3.t() | nil) :: {[float()], 0 | 1 | 2}
  def encode_covariance(nil), do: {@unknown_covariance, 0}

  # A single horizontal accuracy: the vertical value is a guess, so the matrix is marked as approximated.
  def encode_covariance(a) when is_float(a),
    do: {[a * a, 0.0, 0.0, 0.0, a * a, 0.0, 0.0, 0.0, a * a], 1}

  def encode_covariance({e, n, u}), do: {[e * e, 0.0, 0.0, 0.0, n * n, 0.0, 0.0, 0.0, u * u], 2}

  @doc "Converts a transform to a TransformStamped."
  @spec encode_transform(Transform.t(), Situ.Time.t()) :: map()
  def encode_transform(%Transform{pose: pose} = t, time) do
    %{
      "header" => %{"stamp" => max(time, 0), "frame_id" => t.parent},
      "child_frame_id" => t.frame,
      "transform" => %{
        "translation" => encode_vector(pose.position),
        "rotation" => encode_rotation(pose.rotation)
      }
    }
  end

  defp encode_vector({x, y, z}), do: %{"x" => x, "y" => y, "z" => z}
  defp encode_rotation({w, x, y, z}), do: %{"x" => x, "y" => y, "z" => z, "w" => w}
end

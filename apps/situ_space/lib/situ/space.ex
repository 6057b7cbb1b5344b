defmodule Situ.Space do
  @moduledoc """
  Operators on streams of poses, points and other 3D objects: interpolation between messages, velocity from one message
  to the next, and changes of frame.

      head |> Situ.join(gaze, Situ.Space.between()) |> Situ.each(&IO.inspect/1)
      speed = Situ.Space.velocity(head)
      turned = Situ.Space.orientation(imu, gain: 0.5)

  | here | in \\\\psi |
  |---|---|
  | `between/1` | `Interpolators.Reproducible.CoordinateSystem`, `...Ray3D` |
  | `velocity/2` | `GetLinearVelocity3D`, `ComputeVelocity` |
  | `transform_stream/3` | `Transform`, `TransformBy` |
  | `orientation/2` | (none) |

  ## Files of points and surfaces

  These files open like recordings of one message at time 0: `Situ.Store.open("hill.las")`, `situ studio chair.ply`.

  | extension | content read | stream |
  |---|---|---|
  | `.dae` | Collada 1.4 and 1.5: the scene's triangles, in metres and z up, without materials | `Mesh` |
  | `.glb`, `.gltf` | glTF 2.0 with its files, not compressed: the scene's triangles, without materials | `Mesh` |
  | `.las`, `.laz` | LAS 1.0 to 1.4, compressed or not, with colours | `Points`: a `Situ.PointCloud` |
  | `.obj` | OBJ: vertices and faces, without materials | `Mesh`, or `Points` for files without faces |
  | `.pcd` | PCD 0.7 as text, bytes or compressed bytes, with colours | `Points` |
  | `.ply` | PLY as text or bytes, with colours, intensity or faces | `Points`, or `Mesh`: a `Situ.Mesh` |
  | `.stl` | STL as bytes or text | `Mesh` |

  Positions in a LAS file are relative to the lower corner of its bounds, because 32-bit floats cannot represent the
  coordinates of a whole country to the millimetre. `Situ.Store.info/1` reports that corner as `origin`. Files are read
  into memory and may have up to 2 GB.
  """
  alias Situ.{
    Box3,
    Interpolator,
    Line3,
    Mesh,
    Point3,
    PointCloud,
    Pose,
    PoseVelocity,
    Quaternion,
    Ray3,
    Rectangle3,
    Skeleton,
    Vector3,
    Velocity3
  }

  alias Situ.Space.{Cloud, Orientation}

  @doc """
  Returns an interpolator for the pose, ray, skeleton, point or rotation between two messages (`interpolate/3`). The
  result does not depend on timing. It exists only between the first and the last message. Takes the options of
  `Situ.Reproducible.adjacent/2`.
  """
  @spec between(keyword()) :: Interpolator.t()
  def between(opts \\ []), do: Situ.Reproducible.adjacent(&interpolate/3, opts)

  @doc """
  Interpolates between `a` (ratio 0) and `b` (ratio 1): positions on the straight line, rotations on the shortest arc.
  Lists of the same length are interpolated element by element and maps key by key. Returns `nil` if either value is
  `nil` or their kinds differ.

      iex> a = Situ.Pose.identity()
      iex> b = Situ.Pose.new({2.0, 0.0, 0.0})
      iex> Situ.Space.interpolate([a], [b], 0.5) |> hd() |> Map.fetch!(:position)
      {1.0, 0.0, 0.0}
      iex> Situ.Space.interpolate(a, nil, 0.5)
      nil
      iex> Situ.Space.interpolate(Situ.Point3.new(0, 0, 0), Situ.Point3.new(4, 0, 0), 0.25)
      %Situ.Point3{x: 1.0, y: 0.0, z: 0.0}
  """
  @spec interpolate(term(), term(), number()) :: term()
  def interpolate(%Pose{} = a, %Pose{} = b, ratio), do: Pose.interpolate(a, b, ratio)
  def interpolate(%Ray3{} = a, %Ray3{} = b, ratio), do: Ray3.interpolate(a, b, ratio)
  def interpolate(%Skeleton{} = a, %Skeleton{} = b, ratio), do: Skeleton.interpolate(a, b, ratio)

  def interpolate(%Point3{} = a, %Point3{} = b, ratio) do
    {x, y, z} = Vector3.lerp({a.x, a.y, a.z}, {b.x, b.y, b.z}, ratio)
    Point3.new(x, y, z)
  end

  def interpolate({_, _, _} = a, {_, _, _} = b, ratio), do: Vector3.lerp(a, b, ratio)
  def interpolate({_, _, _, _} = a, {_, _, _, _} = b, ratio), do: Quaternion.slerp(a, b, ratio)

  def interpolate(a, b, ratio) when is_list(a) and is_list(b) and length(a) == length(b),
    do: Enum.zip_with(a, b, &interpolate(&1, &2, ratio))

  def interpolate(a, b, ratio)
      when is_map(a) and is_map(b) and not is_struct(a) and not is_struct(b),
      do:
        for(
          {key, value} <- a,
          is_map_key(b, key),
          into: %{},
          do: {key, interpolate(value, b[key], ratio)}
        )

  def interpolate(_a, _b, _ratio), do: nil

  @velocity [
    kind: [
      type: {:in, [:linear, :angular, :pose]},
      default: :linear,
      doc:
        "Whether to compute the linear velocity, the angular one, or (as a `Situ.PoseVelocity`) both."
    ]
  ]

  @doc """
  Computes the velocity of a stream of poses from each message to the next, at the later one's time, as a
  `Situ.Velocity3` or a `Situ.PoseVelocity`.

  #{Situ.Options.docs(@velocity)}
  """
  @spec velocity(Situ.Stream.t(), keyword()) :: Situ.Stream.t()
  def velocity(stream, opts \\ []) do
    {own, placed} = Keyword.split(opts, [:kind])
    [kind: kind] = Situ.Options.validate!(own, @velocity)
    type = if kind == :pose, do: PoseVelocity, else: Velocity3

    stream
    |> Situ.scan(
      {nil, nil},
      fn pose, message, {last, _} ->
        {{message.originating_time, pose}, speed(kind, last, message.originating_time, pose)}
      end,
      name: "Velocities"
    )
    |> Situ.filter(fn {_, velocity} -> velocity != nil end)
    |> Situ.map(&elem(&1, 1), [name: "Velocity", type: type] ++ placed)
  end

  defp speed(_kind, nil, _time, _pose), do: nil

  defp speed(kind, {before, from}, time, to) do
    {:ok, velocity} =
      case kind do
        :linear -> Velocity3.linear_between(from, to, time - before)
        :angular -> Velocity3.angular_between(from, to, time - before)
        :pose -> PoseVelocity.from_poses(from, to, time - before)
      end

    velocity
  end

  @doc """
  Converts a stream of readings of an inertial sensor (`Situ.ImuReading`) to a stream of rotations: quaternions that
  rotate the sensor's axes to north (magnetic north, or the initial heading without a magnetometer), west and up.

  The estimator is a complementary filter on the rotation group (R. Mahony, T. Hamel, J.-M. Pflimlin, Nonlinear
  Complementary Filters on the Special Orthogonal Group, IEEE TAC 53(5), 2008). It integrates the gyroscope. The
  direction of gravity, and the horizontal direction of the magnetic field, correct its drift.

  #{Situ.Options.docs(Orientation.option_schema())}
  """
  @spec orientation(Situ.Stream.t(), keyword()) :: Situ.Stream.t()
  def orientation(stream, opts \\ []) do
    {own, placed} = Keyword.split(opts, Keyword.keys(Orientation.option_schema()))

    stream
    |> Situ.scan(
      Orientation.new(own),
      fn reading, message, o -> Orientation.update(o, reading, message.originating_time) end,
      name: "Readings"
    )
    |> Situ.map(& &1.rotation, [name: "Orientation"] ++ placed)
  end

  @doc """
  Transforms objects from the frame of a pose to the frame in which that pose is given. Objects are poses, points,
  lines, rays, boxes, rectangles, meshes, point clouds and skeletons, and lists of them. They are joined with the stream
  of poses by `between/1` or another interpolator.
  """
  @spec transform_stream(Situ.Stream.t(), Situ.Stream.t(), Interpolator.t() | nil) ::
          Situ.Stream.t()
  def transform_stream(stream, poses, interpolator \\ nil) do
    stream
    |> Situ.join(poses, interpolator || between(), flatten: false)
    |> Situ.map(fn {data, pose} -> transform(data, pose) end, name: "Moved")
  end

  @doc """
  Transforms one object, or a list of objects, by a pose.

      iex> pose = Situ.Pose.new({0.0, 0.0, 1.0})
      iex> Situ.Space.transform(Situ.Point3.new(1, 2, 3), pose)
      %Situ.Point3{x: 1.0, y: 2.0, z: 4.0}
  """
  @spec transform(term(), Pose.t()) :: term()
  def transform(%Pose{} = inner, pose), do: Pose.compose(pose, inner)
  def transform(%Ray3{} = ray, pose), do: Ray3.transform(ray, pose)
  def transform(%Line3{} = line, pose), do: Line3.transform(line, pose)
  def transform(%Box3{} = box, pose), do: Box3.transform(box, pose)
  def transform(%Mesh{} = mesh, pose), do: Mesh.transform(mesh, pose)
  def transform(%Skeleton{} = body, pose), do: Skeleton.transform(body, pose)
  def transform(%Rectangle3{} = r, pose), do: %{r | pose: Pose.compose(pose, r.pose)}

  def transform(%PointCloud{} = cloud, pose),
    do: cloud |> Cloud.transform(pose) |> Situ.Error.unwrap!()

  def transform(%Point3{x: x, y: y, z: z}, pose) do
    {x, y, z} = Pose.transform_point(pose, {x * 1.0, y * 1.0, z * 1.0})
    Point3.new(x, y, z)
  end

  def transform(list, pose) when is_list(list), do: Enum.map(list, &transform(&1, pose))
end

defmodule Situ.Space.Robot do
  @moduledoc """
  A robot: its links, the joints between them, and the shapes of its links. Computes the poses of links and shapes for
  given joint positions. `Situ.Space.Robot.Urdf` reads robots from files.

      {:ok, robot} = Situ.Space.Robot.Urdf.read("arm.urdf")
      joints |> Situ.Space.Robot.shape_stream(robot)        # a stream of Situ.JointState, for a 3D panel
      joints |> Situ.Space.Robot.frame_stream(robot)       # the same as a tree of frames

      iex> alias Situ.Space.Robot
      iex> {:ok, robot} = Robot.Urdf.parse(~s(<robot name="r"><link name="a"/><link name="b"/>) <>
      ...>   ~s(<joint name="j" type="prismatic"><parent link="a"/><child link="b"/>) <>
      ...>   ~s(<axis xyz="0 0 1"/></joint></robot>))
      iex> {:ok, state} = Situ.JointState.new(["j"], [0.5])
      iex> Robot.link_poses(robot, state)["b"].position
      {0.0, 0.0, 0.5}
  """
  alias Situ.{JointState, Mesh, Pose, Quaternion, Transform}

  @enforce_keys [:name, :root, :links, :joints]
  defstruct [:name, :root, :links, :joints]

  @typedoc "A shape in its link's frame, or the reason why its file cannot be read and the position of the shape."
  @type shape :: Mesh.t() | {String.t(), Situ.Point3.t()}
  @typedoc "`mimic` is the joint that this one follows, with a factor and an offset."
  @type joint :: %{
          name: String.t(),
          kind: :fixed | :turning | :sliding,
          parent: String.t(),
          child: String.t(),
          origin: Pose.t(),
          axis: Situ.Vector3.t(),
          mimic: {String.t(), float(), float()} | nil
        }
  @typedoc "Parents come first in `joints`; `root` is the link without a parent."
  @type t :: %__MODULE__{
          name: String.t(),
          root: String.t(),
          links: %{String.t() => [shape()]},
          joints: [joint()]
        }

  @doc "Converts a stream of `Situ.JointState`s to the robot's shapes by link, in the frame of its root."
  @spec shape_stream(Situ.Stream.t(), t(), keyword()) :: Situ.Stream.t()
  def shape_stream(stream, %__MODULE__{} = robot, placed \\ []),
    do: Situ.map(stream, &link_shapes(robot, &1), [name: "Robot", type: :map] ++ placed)

  @doc "Converts a stream of `Situ.JointState`s to the frames of the robot's links: lists of `Situ.Transform`s."
  @spec frame_stream(Situ.Stream.t(), t(), keyword()) :: Situ.Stream.t()
  def frame_stream(stream, %__MODULE__{} = robot, placed \\ []) do
    Situ.map(
      stream,
      &link_transforms(robot, &1),
      [name: "Frames", type: {:list, Transform}] ++ placed
    )
  end

  @doc "Returns the pose of each link in its parent. Joints that `state` does not contain are at 0."
  @spec link_transforms(t(), JointState.t() | nil) :: [Transform.t()]
  def link_transforms(%__MODULE__{joints: joints}, state \\ nil) do
    told = joint_positions(state)

    for joint <- joints,
        do:
          Transform.new(joint.child, joint.parent, joint_pose(joint, joint_position(joint, told)),
            static: joint.kind == :fixed
          )
  end

  @doc "Returns the pose of each link in the root."
  @spec link_poses(t(), JointState.t() | nil) :: %{String.t() => Pose.t()}
  def link_poses(%__MODULE__{} = robot, state \\ nil) do
    robot
    |> link_transforms(state)
    |> Enum.reduce(%{robot.root => Pose.identity()}, fn transform, poses ->
      Map.put(poses, transform.frame, Pose.compose(poses[transform.parent], transform.pose))
    end)
  end

  @doc "Returns the shapes of each link, in the frame of the root."
  @spec link_shapes(t(), JointState.t() | nil) :: %{String.t() => [shape()]}
  def link_shapes(%__MODULE__{links: links} = robot, state \\ nil) do
    poses = link_poses(robot, state)

    for {link, [_ | _] = shapes} <- links,
        into: %{},
        do: {link, Enum.map(shapes, &transform_shape(&1, poses[link]))}
  end

  defp transform_shape(%Mesh{} = mesh, pose), do: Mesh.transform(mesh, pose)
  defp transform_shape({why, point}, pose), do: {why, Situ.Space.transform(point, pose)}

  # A recording may contain lists of different lengths, although `Situ.JointState.new/4` rejects them.
  defp joint_positions(%JointState{names: names, positions: positions}) do
    for {name, x} <- Enum.zip(names, positions),
        is_number(x),
        abs(x) < 1.0e9,
        into: %{},
        do: {name, x / 1}
  end

  defp joint_positions(nil), do: %{}

  defp joint_position(%{mimic: {name, factor, from}}, told),
    do: Map.get(told, name, 0.0) * factor + from

  defp joint_position(%{name: name}, told), do: Map.get(told, name, 0.0)

  defp joint_pose(%{kind: :fixed, origin: origin}, _position), do: origin

  defp joint_pose(%{kind: :turning} = joint, angle),
    do:
      Pose.compose(
        joint.origin,
        Pose.new({0.0, 0.0, 0.0}, Quaternion.from_axis_angle(joint.axis, angle))
      )

  defp joint_pose(%{kind: :sliding, axis: {x, y, z}} = joint, by),
    do: Pose.compose(joint.origin, Pose.new({x * by, y * by, z * by}))
end

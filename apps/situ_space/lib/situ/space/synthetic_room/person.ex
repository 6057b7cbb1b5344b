defmodule Situ.Space.SyntheticRoom.Person do
  @moduledoc false
  # A person in the synthetic room at one time: the joints, and the limbs around them.
  alias Situ.{Pose, Quaternion, Skeleton, Vector3}

  @enforce_keys [:id, :place, :heading]
  defstruct [:id, :place, :heading, stride: 0.0, reach: nil, speaking: false]

  @typedoc """
  `place` is the person's position on the floor (metres), `heading` the direction that the person faces (radians from x
  to y), `stride` the phase of the walk (radians; 0 when standing), `reach` the target of the right arm.
  """
  @type t :: %__MODULE__{
          id: term(),
          place: Vector3.t(),
          heading: float(),
          stride: float() | nil,
          reach: Vector3.t() | nil,
          speaking: boolean()
        }

  @bones [
    {:head, :neck},
    {:neck, :pelvis},
    {:neck, :left_shoulder},
    {:left_shoulder, :left_elbow},
    {:left_elbow, :left_hand},
    {:neck, :right_shoulder},
    {:right_shoulder, :right_elbow},
    {:right_elbow, :right_hand},
    {:pelvis, :left_hip},
    {:left_hip, :left_knee},
    {:left_knee, :left_foot},
    {:pelvis, :right_hip},
    {:right_hip, :right_knee},
    {:right_knee, :right_foot}
  ]
  @arm 0.29
  @thigh 0.42
  @shin 0.42

  @doc "Builds a standing person at a position."
  @spec new_standing(term(), Vector3.t(), float()) :: t()
  def new_standing(id, place, heading), do: %__MODULE__{id: id, place: place, heading: heading}

  @doc """
  Returns the joints in the room's frame; each has the rotation of the body.

      iex> alias Situ.Space.SyntheticRoom.Person
      iex> body = Person.to_skeleton(Person.new_standing(7, {2.0, 0.0, 0.0}, 0.0))
      iex> {body.id, map_size(body.joints), Situ.Skeleton.joint_position(body, :head)}
      {7, 15, {2.0, 0.0, 1.62}}
  """
  @spec to_skeleton(t()) :: Skeleton.t()
  def to_skeleton(%__MODULE__{} = person) do
    turn = Quaternion.from_axis_angle({0.0, 0.0, 1.0}, person.heading)

    joints =
      person
      |> joint_positions(Pose.new(person.place, turn))
      |> Map.new(fn {name, position} -> {name, %Pose{position: position, rotation: turn}} end)

    Skeleton.new!(joints, @bones, id: person.id)
  end

  defp joint_positions(person, body) do
    swing = 0.55 * :math.sin(person.stride)
    at = &Pose.transform_point(body, &1)

    trunk = %{
      head: at.({0.0, 0.0, 1.62}),
      neck: at.({0.0, 0.0, 1.42}),
      pelvis: at.({0.0, 0.0, 0.92}),
      left_shoulder: at.({0.0, 0.19, 1.38}),
      right_shoulder: at.({0.0, -0.19, 1.38}),
      left_hip: at.({0.0, 0.1, 0.88}),
      right_hip: at.({0.0, -0.1, 0.88})
    }

    trunk
    |> Map.merge(leg_joints(at, :left, 0.1, swing))
    |> Map.merge(leg_joints(at, :right, -0.1, -swing))
    |> Map.merge(arm_joints(at, :left, 0.22, -swing))
    |> Map.merge(right_arm_joints(person, trunk.right_shoulder, at, swing))
  end

  defp leg_joints(at, side, y, swing) do
    bend = if swing < 0, do: -swing, else: 0.0
    {kx, kz} = {@thigh * :math.sin(swing), 0.88 - @thigh * :math.cos(swing)}
    foot = {kx + @shin * :math.sin(swing - bend), y, kz - @shin * :math.cos(swing - bend)}
    %{joint_name(side, :knee) => at.({kx, y, kz}), joint_name(side, :foot) => at.(foot)}
  end

  defp arm_joints(at, side, y, swing) do
    {ex, ez} = {@arm * :math.sin(swing), 1.38 - @arm * :math.cos(swing)}
    bend = swing + 0.3
    hand = {ex + @arm * :math.sin(bend), y, ez - @arm * :math.cos(bend)}
    %{joint_name(side, :elbow) => at.({ex, y, ez}), joint_name(side, :hand) => at.(hand)}
  end

  defp right_arm_joints(%{reach: nil}, _shoulder, at, swing),
    do: arm_joints(at, :right, -0.22, swing)

  defp right_arm_joints(%{reach: target}, shoulder, _at, _swing) do
    {:ok, way} = target |> Vector3.subtract(shoulder) |> Vector3.normalize()
    along = &Vector3.add(shoulder, Vector3.scale(way, &1))
    %{right_elbow: along.(@arm), right_hand: along.(2 * @arm)}
  end

  defp joint_name(:left, :knee), do: :left_knee
  defp joint_name(:right, :knee), do: :right_knee
  defp joint_name(:left, :foot), do: :left_foot
  defp joint_name(:right, :foot), do: :right_foot
  defp joint_name(:left, :elbow), do: :left_elbow
  defp joint_name(:right, :elbow), do: :right_elbow
  defp joint_name(:left, :hand), do: :left_hand
  defp joint_name(:right, :hand), do: :right_hand

  @skin {224, 172, 132}
  @lit {255, 236, 170}
  @clothes [{46, 96, 168}, {168, 62, 58}, {70, 130, 80}, {150, 110, 40}]
  @trousers {52, 56, 66}

  @doc "Returns the limbs as shapes for the renderer. A speaking person has a brighter head."
  @spec body_shapes(t(), Skeleton.t()) :: [tuple()]
  def body_shapes(%__MODULE__{} = person, %Skeleton{} = body) do
    shirt = Enum.at(@clothes, :erlang.phash2(person.id, length(@clothes)))
    head = if person.speaking, do: @lit, else: @skin
    p = &Skeleton.joint_position(body, &1)
    limb = fn a, b, radius, color -> {:capsule, p.(a), p.(b), radius, color} end

    [
      {:capsule, p.(:head), p.(:head), 0.13, head},
      limb.(:neck, :pelvis, 0.15, shirt),
      limb.(:left_shoulder, :right_shoulder, 0.09, shirt),
      limb.(:left_shoulder, :left_elbow, 0.055, shirt),
      limb.(:right_shoulder, :right_elbow, 0.055, shirt),
      limb.(:left_elbow, :left_hand, 0.045, @skin),
      limb.(:right_elbow, :right_hand, 0.045, @skin),
      limb.(:left_hip, :right_hip, 0.12, @trousers),
      limb.(:left_hip, :left_knee, 0.08, @trousers),
      limb.(:right_hip, :right_knee, 0.08, @trousers),
      limb.(:left_knee, :left_foot, 0.06, @trousers),
      limb.(:right_knee, :right_foot, 0.06, @trousers)
    ]
  end
end

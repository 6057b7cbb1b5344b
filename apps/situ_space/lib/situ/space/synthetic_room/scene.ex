defmodule Situ.Space.SyntheticRoom.Scene do
  @moduledoc false
  # The synthetic room as an exact function of time. Person 0 walks back and forth, and person 1
  # points at a floating ball. They take turns speaking.
  alias Situ.{ImuReading, Pose, Quaternion, Ray3, Skeleton, Vector3}
  alias Situ.Space.SyntheticRoom.Person

  @enforce_keys [:people, :bodies, :ball, :camera]
  defstruct [:people, :bodies, :ball, :camera]

  @typedoc "`ball` is the position of its centre, `camera` the camera's pose; times are seconds from the start."
  @type t :: %__MODULE__{
          people: [Person.t()],
          bodies: [Skeleton.t()],
          ball: Vector3.t(),
          camera: Pose.t()
        }

  @typedoc "When people speak: the person's id, start and end in seconds."
  @type speech :: [{term(), number(), number()}]

  @gravity 9.80665
  @ball 0.12
  @step 1.0e-4

  @doc """
  Returns the room at `t` seconds. `speech` lists when each person speaks; by default, each of them speaks for two
  seconds in turn, with pauses of half a second. `sway` is how far (metres and radians) the camera moves around its
  position.

      iex> alias Situ.Space.SyntheticRoom.Scene
      iex> scene = Scene.state_at(1.0)
      iex> for person <- scene.people, do: {person.id, person.speaking}
      [{0, true}, {1, false}]
      iex> Scene.state_at(1.0) == scene
      true
  """
  @spec state_at(number(), speech() | nil, number()) :: t()
  def state_at(t, speech \\ nil, sway \\ 0.0) do
    ball = ball_position(t)
    speaks? = &speaking?(&1, t, speech)

    people = [
      %{walking_person(t) | speaking: speaks?.(0)},
      %{Person.new_standing(1, {3.4, -1.0, 0.0}, 2.6) | reach: ball, speaking: speaks?.(1)}
    ]

    %__MODULE__{
      people: people,
      bodies: Enum.map(people, &Person.to_skeleton/1),
      ball: ball,
      camera: camera_pose(t, sway)
    }
  end

  @doc "Returns whether a person speaks at `t` seconds."
  @spec speaking?(term(), number(), speech() | nil) :: boolean()
  def speaking?(id, t, nil) do
    turn = floor(t / 2.5)
    t - turn * 2.5 < 2.0 and Integer.mod(turn, 2) == id
  end

  def speaking?(id, t, speech),
    do: Enum.any?(speech, fn {who, from, to} -> who == id and t >= from and t < to end)

  # The person walks back and forth along y, and the feet move at the speed of the body.
  defp walking_person(t) do
    place = fn t -> {3.0 + 0.35 * :math.cos(0.5 * t), 0.2 + 0.9 * :math.sin(0.5 * t), 0.0} end
    {x, y, _} = Vector3.subtract(place.(t + @step), place.(t))

    %Person{
      id: 0,
      place: place.(t),
      heading: :math.atan2(y, x),
      stride: 2.4 * 1.8 * :math.sin(0.5 * t)
    }
  end

  defp ball_position(t) do
    {2.5 + 0.25 * :math.sin(0.9 * t), 0.1 + 0.7 * :math.cos(0.6 * t),
     1.5 + 0.25 * :math.sin(1.3 * t)}
  end

  defp camera_pose(t, sway) do
    position = {
      0.2 + sway * :math.sin(1.1 * t),
      sway * :math.sin(0.7 * t),
      1.5 + sway * 0.5 * :math.sin(1.7 * t)
    }

    yaw = sway * :math.sin(0.8 * t)
    pitch = 0.12 + sway * 0.5 * :math.sin(1.3 * t)
    Pose.new(position, Quaternion.from_euler(yaw, pitch, 0.0))
  end

  @doc "Returns all visible shapes for the renderer: walls, furniture, ball, people."
  @spec list_shapes(t()) :: [tuple()]
  def list_shapes(%__MODULE__{} = scene) do
    limbs =
      scene.people
      |> Enum.zip(scene.bodies)
      |> Enum.flat_map(fn {p, b} -> Person.body_shapes(p, b) end)

    furniture_shapes() ++ [{:capsule, scene.ball, scene.ball, @ball, {240, 150, 30}} | limbs]
  end

  defp furniture_shapes do
    [
      {:box, {-1.0, -2.2, 0.0}, {5.0, 2.2, 2.8}, {188, 184, 174}},
      {:box, {-0.9, -2.1, -0.1}, {4.9, 2.1, 0.01}, {120, 104, 88}},
      {:box, {3.7, 0.5, 0.70}, {4.6, 1.9, 0.76}, {140, 96, 56}},
      {:box, {3.75, 0.55, 0.0}, {3.82, 0.62, 0.70}, {110, 74, 44}},
      {:box, {4.48, 0.55, 0.0}, {4.55, 0.62, 0.70}, {110, 74, 44}},
      {:box, {3.75, 1.78, 0.0}, {3.82, 1.85, 0.70}, {110, 74, 44}},
      {:box, {4.48, 1.78, 0.0}, {4.55, 1.85, 0.70}, {110, 74, 44}},
      {:box, {4.0, 0.8, 0.76}, {4.3, 1.2, 1.05}, {80, 140, 120}},
      {:box, {4.95, -1.2, 0.9}, {5.0, 0.1, 1.9}, {70, 80, 100}},
      {:box, {4.55, -2.15, 0.0}, {4.95, -1.5, 1.5}, {170, 160, 140}}
    ]
  end

  @doc "Returns the ray along which the second person points, in the direction from the shoulder to the hand."
  @spec pointing_ray(t()) :: Ray3.t()
  def pointing_ray(%__MODULE__{bodies: [_, body]}) do
    shoulder = Skeleton.joint_position(body, :right_shoulder)
    hand = Skeleton.joint_position(body, :right_hand)
    {:ok, ray} = Ray3.new(hand, Vector3.subtract(hand, shoulder))
    ray
  end

  @doc "Returns the reading of an inertial sensor in the camera at `t` seconds, from its poses within 20 ms."
  @spec imu_reading(number(), number()) :: ImuReading.t()
  def imu_reading(t, sway) do
    h = 1.0e-2

    {before, now, later} =
      {camera_pose(t - h, sway), camera_pose(t, sway), camera_pose(t + h, sway)}

    sum = Vector3.add(before.position, later.position)
    moved = Vector3.subtract(sum, Vector3.scale(now.position, 2.0))
    force = Vector3.add(Vector3.scale(moved, 1 / (h * h)), {0.0, 0.0, @gravity})
    inverse = Quaternion.invert(now.rotation)

    {axis, angle} =
      before.rotation
      |> Quaternion.invert()
      |> Quaternion.multiply(later.rotation)
      |> Quaternion.to_axis_angle()

    ImuReading.new(Quaternion.rotate_vector(inverse, force), Vector3.scale(axis, angle / (2 * h)))
  end
end

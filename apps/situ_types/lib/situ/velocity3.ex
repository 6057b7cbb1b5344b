defmodule Situ.Velocity3 do
  @moduledoc """
  The velocity of an object: `:linear` (metres per second along a direction) or `:angular` (radians per second around
  an axis), with the object's position and, for angular velocities, its `rotation`. `Situ.PoseVelocity` holds both
  velocities.

      iex> a = Situ.Pose.identity()
      iex> b = Situ.Pose.new({0.0, 1.0, 0.0})
      iex> {:ok, velocity} = Situ.Velocity3.linear_between(a, b, Situ.Time.ms(500))
      iex> {velocity.direction, velocity.magnitude, Situ.Velocity3.extrapolate_by(velocity, Situ.Time.s(2))}
      {{0.0, 1.0, 0.0}, 2.0, {0.0, 5.0, 0.0}}
  """
  alias Situ.{Error, Pose, Quaternion, Vector3}

  @enforce_keys [:kind, :origin, :direction, :magnitude]
  defstruct [:kind, :origin, :direction, :magnitude, rotation: nil]

  @type t :: %__MODULE__{
          kind: :linear | :angular,
          origin: Vector3.t(),
          direction: Vector3.t(),
          magnitude: float(),
          rotation: Quaternion.t() | nil
        }

  @doc "Returns the linear velocity between two poses `duration` ns apart, at the later pose (along x if at rest)."
  @spec linear_between(Pose.t(), Pose.t(), Situ.Time.duration()) ::
          {:ok, t()} | {:error, Error.t()}
  def linear_between(%Pose{} = from, %Pose{} = to, duration) do
    moved = Vector3.subtract(to.position, from.position)
    direction = with {:ok, unit} <- Vector3.normalize(moved), do: unit
    direction = if direction == :error, do: {1.0, 0.0, 0.0}, else: direction
    build_velocity(:linear, to.position, direction, Vector3.norm(moved), duration)
  end

  @doc "Returns the angular velocity between two poses `duration` ns apart, at the later pose."
  @spec angular_between(Pose.t(), Pose.t(), Situ.Time.duration()) ::
          {:ok, t()} | {:error, Error.t()}
  def angular_between(%Pose{} = from, %Pose{} = to, duration) do
    {axis, angle} =
      to.rotation
      |> Quaternion.multiply(Quaternion.invert(from.rotation))
      |> Quaternion.to_axis_angle()

    with {:ok, velocity} <- build_velocity(:angular, to.position, axis, angle, duration),
         do: {:ok, %{velocity | rotation: to.rotation}}
  end

  defp build_velocity(kind, origin, direction, moved, duration)
       when is_integer(duration) and duration > 0 do
    {:ok,
     %__MODULE__{
       kind: kind,
       origin: origin,
       direction: direction,
       magnitude: moved * 1.0e9 / duration
     }}
  end

  defp build_velocity(_kind, _origin, _direction, _moved, duration),
    do:
      {:error,
       Error.new(:bad_duration, "cannot compute a velocity over #{inspect(duration)} ns",
         why: "the duration must be a positive integer"
       )}

  @doc """
  Extrapolates by `duration` ns at constant velocity. Returns the position for a linear velocity and the rotation for
  an angular one.

      iex> turned = Situ.Pose.new({0.0, 0.0, 0.0}, Situ.Quaternion.from_euler(0.5, 0, 0))
      iex> {:ok, velocity} = Situ.Velocity3.angular_between(Situ.Pose.identity(), turned, Situ.Time.ms(500))
      iex> {yaw, _, _} = velocity |> Situ.Velocity3.extrapolate_by(Situ.Time.s(1)) |> Situ.Quaternion.to_euler()
      iex> Float.round(yaw, 9)
      1.5
  """
  @spec extrapolate_by(t(), Situ.Time.duration()) :: Vector3.t() | Quaternion.t()
  def extrapolate_by(%__MODULE__{kind: :linear} = velocity, duration),
    do:
      Vector3.add(
        velocity.origin,
        Vector3.scale(velocity.direction, velocity.magnitude * duration / 1.0e9)
      )

  def extrapolate_by(%__MODULE__{kind: :angular} = velocity, duration) do
    velocity.direction
    |> Quaternion.from_axis_angle(velocity.magnitude * duration / 1.0e9)
    |> Quaternion.multiply(velocity.rotation || Quaternion.identity())
  end
end

defmodule Situ.PoseVelocity do
  @moduledoc """
  The linear and angular velocity of a pose: its pose, its linear velocity (metres per second) and its angular
  velocity (radians per second around an axis), all in the same frame. `Situ.Velocity3` holds a single velocity.

      iex> a = Situ.Pose.identity()
      iex> b = Situ.Pose.new({0.0, 1.0, 0.0}, Situ.Quaternion.from_euler(0.5, 0, 0))
      iex> {:ok, velocity} = Situ.PoseVelocity.from_poses(a, b, Situ.Time.ms(500))
      iex> later = Situ.PoseVelocity.pose_after(velocity, Situ.Time.s(1))
      iex> {yaw, _, _} = Situ.Quaternion.to_euler(later.rotation)
      iex> {velocity.linear, later.position, Float.round(yaw, 9)}
      {{0.0, 2.0, 0.0}, {0.0, 3.0, 0.0}, 1.5}
  """
  alias Situ.{Error, Pose, Quaternion, Vector3, Velocity3}

  @enforce_keys [:pose, :linear, :angular]
  defstruct [:pose, :linear, :angular]

  @typedoc "`angular` is the rotation axis; its length is the angular speed."
  @type t :: %__MODULE__{pose: Pose.t(), linear: Vector3.t(), angular: Vector3.t()}

  @doc "Returns the velocity between two poses that are `duration` ns apart, at the later pose."
  @spec from_poses(Pose.t(), Pose.t(), Situ.Time.duration()) :: {:ok, t()} | {:error, Error.t()}
  def from_poses(%Pose{} = from, %Pose{} = to, duration) do
    with {:ok, moves} <- Velocity3.linear_between(from, to, duration),
         {:ok, turns} <- Velocity3.angular_between(from, to, duration) do
      {:ok,
       %__MODULE__{
         pose: to,
         linear: Vector3.scale(moves.direction, moves.magnitude),
         angular: Vector3.scale(turns.direction, turns.magnitude)
       }}
    end
  end

  @doc "Extrapolates the pose by `duration` ns at constant velocity; a negative duration goes back in time."
  @spec pose_after(t(), Situ.Time.duration()) :: Pose.t()
  def pose_after(%__MODULE__{pose: pose} = velocity, duration) do
    seconds = duration / 1.0e9

    turn =
      case Vector3.normalize(velocity.angular) do
        {:ok, axis} -> Quaternion.from_axis_angle(axis, Vector3.norm(velocity.angular) * seconds)
        :error -> Quaternion.identity()
      end

    Pose.new(
      Vector3.add(pose.position, Vector3.scale(velocity.linear, seconds)),
      Quaternion.multiply(turn, pose.rotation)
    )
  end
end

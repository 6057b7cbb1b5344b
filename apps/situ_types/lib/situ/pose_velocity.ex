defmodule Situ.PoseVelocity do
  @moduledoc """
  How a pose moves and turns at once: where it is, how fast it goes (metres a second) and how fast it turns (radians a
  second around an axis), both in the frame that the pose is given in. `Situ.Velocity3` is one of the two alone.

      iex> a = Situ.Pose.identity()
      iex> b = Situ.Pose.new({0.0, 1.0, 0.0}, Situ.Quaternion.from_euler(0.5, 0, 0))
      iex> {:ok, velocity} = Situ.PoseVelocity.between(a, b, Situ.Time.ms(500))
      iex> later = Situ.PoseVelocity.destination(velocity, Situ.Time.s(1))
      iex> {yaw, _, _} = Situ.Quaternion.to_euler(later.rotation)
      iex> {velocity.linear, later.position, Float.round(yaw, 9)}
      {{0.0, 2.0, 0.0}, {0.0, 3.0, 0.0}, 1.5}
  """
  alias Situ.{Error, Pose, Quaternion, Vector3, Velocity3}

  @enforce_keys [:pose, :linear, :angular]
  defstruct [:pose, :linear, :angular]

  @typedoc "`angular` is the axis, as long as it turns fast."
  @type t :: %__MODULE__{pose: Pose.t(), linear: Vector3.t(), angular: Vector3.t()}

  @doc "The velocity between two poses that are `duration` ns apart, at the later one."
  @spec between(Pose.t(), Pose.t(), Situ.Time.duration()) :: {:ok, t()} | {:error, Error.t()}
  def between(%Pose{} = from, %Pose{} = to, duration) do
    with {:ok, moves} <- Velocity3.linear(from, to, duration),
         {:ok, turns} <- Velocity3.angular(from, to, duration) do
      {:ok,
       %__MODULE__{
         pose: to,
         linear: Vector3.scale(moves.direction, moves.magnitude),
         angular: Vector3.scale(turns.direction, turns.magnitude)
       }}
    end
  end

  @doc "The pose of something that goes and turns on like this after `duration` ns (before, where it is negative)."
  @spec destination(t(), Situ.Time.duration()) :: Pose.t()
  def destination(%__MODULE__{pose: pose} = velocity, duration) do
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

defmodule Situ.ImuReading do
  @moduledoc """
  One reading of an inertial sensor, in the sensor's axes (x forward, y left, z up). It holds the specific force
  (m/s2; +9.81 upwards at rest), the angular velocity (rad/s, right-handed) and, if there is a magnetometer, the
  magnetic field (any unit). For sensors that estimate their own orientation, `orientation` is the rotation from
  sensor axes to world axes.

      iex> Situ.ImuReading.new({0.0, 0.0, 9.81}, {0.0, 0.0, 0.1}).magnetic_field
      nil
  """
  alias Situ.{Quaternion, Vector3}

  @enforce_keys [:acceleration, :angular_velocity]
  defstruct [:acceleration, :angular_velocity, magnetic_field: nil, orientation: nil]

  @type t :: %__MODULE__{
          acceleration: Vector3.t(),
          angular_velocity: Vector3.t(),
          magnetic_field: Vector3.t() | nil,
          orientation: Quaternion.t() | nil
        }

  @doc "Builds a reading."
  @spec new(Vector3.t(), Vector3.t(), Vector3.t() | nil) :: t()
  def new({_, _, _} = acceleration, {_, _, _} = angular_velocity, magnetic_field \\ nil) do
    %__MODULE__{
      acceleration: acceleration,
      angular_velocity: angular_velocity,
      magnetic_field: magnetic_field
    }
  end
end

defmodule Situ.ImuReading do
  @moduledoc """
  One reading of an inertial sensor, in its own axes (x forward, y left, z up): the specific force (m/s2; at rest +9.81
  along what is up), the rate of turning (rad/s, right-handed) and, where there is a magnetometer, the field (any unit).
  A sensor that works out by itself how it is turned has an `orientation`: the rotation that takes its axes to those of
  the world.

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

  @doc "A reading."
  @spec new(Vector3.t(), Vector3.t(), Vector3.t() | nil) :: t()
  def new({_, _, _} = acceleration, {_, _, _} = angular_velocity, magnetic_field \\ nil) do
    %__MODULE__{
      acceleration: acceleration,
      angular_velocity: angular_velocity,
      magnetic_field: magnetic_field
    }
  end
end

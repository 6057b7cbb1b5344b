defmodule Situ.Point3 do
  @moduledoc """
  A point in space, in metres: `x` forward, `y` left, `z` up, as in \\\\psi and ROS.

      iex> Situ.Point3.distance(%Situ.Point3{x: 0, y: 0, z: 0}, %Situ.Point3{x: 1, y: 2, z: 2})
      3.0
  """
  @enforce_keys [:x, :y, :z]
  defstruct [:x, :y, :z]

  @type t :: %__MODULE__{x: number(), y: number(), z: number()}

  @doc "Builds a point from three numbers."
  @spec new(number(), number(), number()) :: t()
  def new(x, y, z) when is_number(x) and is_number(y) and is_number(z),
    do: %__MODULE__{x: x, y: y, z: z}

  @doc "Returns the Euclidean distance."
  @spec distance(t(), t()) :: float()
  def distance(%__MODULE__{} = a, %__MODULE__{} = b) do
    {x, y, z} = {a.x - b.x, a.y - b.y, a.z - b.z}
    :math.sqrt(x * x + y * y + z * z)
  end
end

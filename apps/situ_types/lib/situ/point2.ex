defmodule Situ.Point2 do
  @moduledoc """
  A point in an image or a plane: `x` to the right, `y` down, in pixels unless stated otherwise.

      iex> Situ.Point2.distance(%Situ.Point2{x: 0, y: 0}, %Situ.Point2{x: 3, y: 4})
      5.0
  """
  @enforce_keys [:x, :y]
  defstruct [:x, :y]

  @type t :: %__MODULE__{x: number(), y: number()}

  @doc "Builds a point from two numbers."
  @spec new(number(), number()) :: t()
  def new(x, y) when is_number(x) and is_number(y), do: %__MODULE__{x: x, y: y}

  @doc "Returns the Euclidean distance."
  @spec distance(t(), t()) :: float()
  def distance(%__MODULE__{} = a, %__MODULE__{} = b),
    do: :math.sqrt((a.x - b.x) * (a.x - b.x) + (a.y - b.y) * (a.y - b.y))
end

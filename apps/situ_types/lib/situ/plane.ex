defmodule Situ.Plane do
  @moduledoc """
  A plane in space: all points `p` with `normal . p = offset`; the normal is a unit vector.

      iex> {:ok, floor} = Situ.Plane.through({0.0, 0.0, 1.0}, {1.0, 0.0, 1.0}, {0.0, 1.0, 1.0})
      iex> {floor.normal, floor.offset, Situ.Plane.distance(floor, {5.0, 5.0, 3.0})}
      {{0.0, 0.0, 1.0}, 1.0, 2.0}
  """
  alias Situ.{Error, Ray3, Vector3}

  @enforce_keys [:normal, :offset]
  defstruct [:normal, :offset]

  @type t :: %__MODULE__{normal: Vector3.t(), offset: float()}

  @doc "The plane through three points; they must not lie on one line."
  @spec through(Vector3.t(), Vector3.t(), Vector3.t()) :: {:ok, t()} | {:error, Error.t()}
  def through(a, b, c) do
    case Vector3.subtract(b, a) |> Vector3.cross(Vector3.subtract(c, a)) |> Vector3.normalize() do
      {:ok, normal} ->
        {:ok, %__MODULE__{normal: normal, offset: Vector3.dot(normal, a)}}

      :error ->
        {:error,
         Error.new(
           :degenerate_plane,
           "three points on one line span no plane: #{inspect([a, b, c])}"
         )}
    end
  end

  @doc "Signed distance (metres): positive on the side the normal points to."
  @spec distance(t(), Vector3.t()) :: float()
  def distance(%__MODULE__{} = plane, point), do: Vector3.dot(plane.normal, point) - plane.offset

  @doc "The nearest point of the plane."
  @spec project(t(), Vector3.t()) :: Vector3.t()
  def project(%__MODULE__{} = plane, point),
    do: Vector3.subtract(point, Vector3.scale(plane.normal, distance(plane, point)))

  @doc "Where a ray meets the plane; `nil` where it runs beside it or away from it."
  @spec intersection(t(), Ray3.t()) :: Vector3.t() | nil
  def intersection(%__MODULE__{} = plane, %Ray3{} = ray) do
    slope = Vector3.dot(plane.normal, ray.direction)

    if abs(slope) > 1.0e-12 do
      along = -distance(plane, ray.origin) / slope
      if along >= 0, do: Ray3.point_at(ray, along)
    end
  end
end

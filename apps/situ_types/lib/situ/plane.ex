defmodule Situ.Plane do
  @moduledoc """
  A plane in space: all points `p` with `normal . p = offset`, where the normal is a unit vector.

      iex> {:ok, floor} = Situ.Plane.from_points({0.0, 0.0, 1.0}, {1.0, 0.0, 1.0}, {0.0, 1.0, 1.0})
      iex> {floor.normal, floor.offset, Situ.Plane.signed_distance(floor, {5.0, 5.0, 3.0})}
      {{0.0, 0.0, 1.0}, 1.0, 2.0}
  """
  alias Situ.{Error, Ray3, Vector3}

  @enforce_keys [:normal, :offset]
  defstruct [:normal, :offset]

  @type t :: %__MODULE__{normal: Vector3.t(), offset: float()}

  @doc "Builds the plane through three points, which must not be on one line."
  @spec from_points(Vector3.t(), Vector3.t(), Vector3.t()) :: {:ok, t()} | {:error, Error.t()}
  def from_points(a, b, c) do
    case Vector3.subtract(b, a)
         |> Vector3.cross_product(Vector3.subtract(c, a))
         |> Vector3.normalize() do
      {:ok, normal} ->
        {:ok, %__MODULE__{normal: normal, offset: Vector3.dot_product(normal, a)}}

      :error ->
        {:error,
         Error.new(
           :degenerate_plane,
           "three points on one line do not define a plane: #{inspect([a, b, c])}"
         )}
    end
  end

  @doc "Returns the signed distance (metres), positive on the side that the normal points to."
  @spec signed_distance(t(), Vector3.t()) :: float()
  def signed_distance(%__MODULE__{} = plane, point),
    do: Vector3.dot_product(plane.normal, point) - plane.offset

  @doc "Projects `point` onto the plane."
  @spec project_point(t(), Vector3.t()) :: Vector3.t()
  def project_point(%__MODULE__{} = plane, point),
    do: Vector3.subtract(point, Vector3.scale(plane.normal, signed_distance(plane, point)))

  @doc "Returns the point where a ray hits the plane, or `nil` if it is parallel or points away."
  @spec intersect_ray(t(), Ray3.t()) :: Vector3.t() | nil
  def intersect_ray(%__MODULE__{} = plane, %Ray3{} = ray) do
    slope = Vector3.dot_product(plane.normal, ray.direction)

    if abs(slope) > 1.0e-12 do
      along = -signed_distance(plane, ray.origin) / slope
      if along >= 0, do: Ray3.point_at(ray, along)
    end
  end
end

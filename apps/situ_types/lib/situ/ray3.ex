defmodule Situ.Ray3 do
  @moduledoc """
  A ray in space: its origin (metres) and its direction (a unit vector).

      iex> {:ok, ray} = Situ.Ray3.new({0.0, 0.0, 1.0}, {2.0, 0.0, 0.0})
      iex> Situ.Ray3.point_at(ray, 3)
      {3.0, 0.0, 1.0}
  """
  alias Situ.{Error, Pose, Quaternion, Vector3}

  @enforce_keys [:origin, :direction]
  defstruct [:origin, :direction]

  @type t :: %__MODULE__{origin: Vector3.t(), direction: Vector3.t()}

  @doc "Builds the ray from `origin` along `direction`, whose length must not be 0."
  @spec new(Vector3.t(), Vector3.t()) :: {:ok, t()} | {:error, Error.t()}
  def new(origin, direction) do
    case Vector3.normalize(direction) do
      {:ok, unit} ->
        {:ok, %__MODULE__{origin: origin, direction: unit}}

      :error ->
        {:error,
         Error.new(
           :degenerate_ray,
           "invalid ray direction #{inspect(direction)}: its length is 0"
         )}
    end
  end

  @doc "Builds the ray along the x axis of a pose, the viewing direction of a camera or head."
  @spec from_pose(Pose.t()) :: t()
  def from_pose(%Pose{} = pose),
    do: %__MODULE__{
      origin: pose.position,
      direction: Quaternion.rotate_vector(pose.rotation, {1.0, 0.0, 0.0})
    }

  @doc "Returns the point at a distance (metres) along the ray."
  @spec point_at(t(), number()) :: Vector3.t()
  def point_at(%__MODULE__{} = ray, distance),
    do: Vector3.add(ray.origin, Vector3.scale(ray.direction, distance))

  @doc "Transforms the ray from the pose's local frame to the frame in which the pose is given."
  @spec transform(t(), Pose.t()) :: t()
  def transform(%__MODULE__{} = ray, %Pose{} = pose) do
    %__MODULE__{
      origin: Pose.transform_point(pose, ray.origin),
      direction: Quaternion.rotate_vector(pose.rotation, ray.direction)
    }
  end

  @doc "Returns the distance (metres) from a point to the nearest point of the ray."
  @spec distance_to(t(), Vector3.t()) :: float()
  def distance_to(%__MODULE__{} = ray, point) do
    along = point |> Vector3.subtract(ray.origin) |> Vector3.dot_product(ray.direction)
    Vector3.distance(point, point_at(ray, max(along, 0.0)))
  end

  @doc """
  Interpolates between `a` (ratio 0) and `b` (ratio 1): origins on the straight line, directions blended and
  normalized. Returns `nil` if either is `nil` or if opposite directions cancel out.
  """
  @spec interpolate(t() | nil, t() | nil, number()) :: t() | nil
  def interpolate(%__MODULE__{} = a, %__MODULE__{} = b, ratio) do
    case a.direction |> Vector3.lerp(b.direction, ratio) |> Vector3.normalize() do
      {:ok, direction} ->
        %__MODULE__{origin: Vector3.lerp(a.origin, b.origin, ratio), direction: direction}

      :error ->
        nil
    end
  end

  def interpolate(_a, _b, _ratio), do: nil
end

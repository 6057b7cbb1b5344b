defmodule Situ.Rectangle3 do
  @moduledoc """
  A flat rectangle in space: the pose of its center, whose x axis is the normal, and its width (along y) and height
  (along z) in metres.

      iex> wall = Situ.Rectangle3.new!(Situ.Pose.new({2.0, 0.0, 1.0}), 4, 2)
      iex> {:ok, ray} = Situ.Ray3.new({0.0, 1.0, 1.0}, {1.0, 0.0, 0.0})
      iex> Situ.Rectangle3.intersect_ray(wall, ray)
      {2.0, 1.0, 1.0}
  """
  alias Situ.{Error, Plane, Pose, Ray3, Vector3}

  @enforce_keys [:pose, :width, :height]
  defstruct [:pose, :width, :height]

  @type t :: %__MODULE__{pose: Pose.t(), width: float(), height: float()}

  @doc "Builds a rectangle centered at a pose; width and height must be 0 or more."
  @spec new(Pose.t(), number(), number()) :: {:ok, t()} | {:error, Error.t()}
  def new(%Pose{} = pose, width, height) when is_number(width) and is_number(height) do
    if width >= 0 and height >= 0,
      do: {:ok, %__MODULE__{pose: pose, width: width * 1.0, height: height * 1.0}},
      else:
        {:error,
         Error.new(
           :bad_rectangle,
           "invalid rectangle size #{width} m x #{height} m: it must not be negative"
         )}
  end

  @doc "Like `new/3`, but returns the rectangle or raises the error."
  @spec new!(Pose.t(), number(), number()) :: t()
  def new!(pose, width, height), do: pose |> new(width, height) |> Error.unwrap!()

  @doc "Returns the corners top left, top right, bottom right, bottom left, as seen against the normal."
  @spec corner_points(t()) :: [Vector3.t()]
  def corner_points(%__MODULE__{pose: pose, width: w, height: h}) do
    for {y, z} <- [{-w / 2, h / 2}, {w / 2, h / 2}, {w / 2, -h / 2}, {-w / 2, -h / 2}],
        do: Pose.transform_point(pose, {0.0, y, z})
  end

  @doc "Returns the plane that contains the rectangle."
  @spec containing_plane(t()) :: Plane.t()
  def containing_plane(%__MODULE__{pose: pose}) do
    {normal, _, _} = Pose.axis_directions(pose)
    %Plane{normal: normal, offset: Vector3.dot_product(normal, pose.position)}
  end

  @doc "Returns the point where a ray hits the rectangle, or `nil` if it misses."
  @spec intersect_ray(t(), Ray3.t()) :: Vector3.t() | nil
  def intersect_ray(%__MODULE__{} = rectangle, %Ray3{} = ray) do
    with {_, _, _} = point <- Plane.intersect_ray(containing_plane(rectangle), ray),
         do: if(contains_point?(rectangle, point, 1.0e-9), do: point)
  end

  @doc "Returns whether a point is on the rectangle or at most `epsilon` (metres) away from it."
  @spec contains_point?(t(), Vector3.t(), number()) :: boolean()
  def contains_point?(%__MODULE__{} = rectangle, point, epsilon \\ 1.0e-6),
    do: Vector3.distance(closest_point(rectangle, point), point) <= epsilon

  @doc "Returns the point of the rectangle nearest to `point`."
  @spec closest_point(t(), Vector3.t()) :: Vector3.t()
  def closest_point(%__MODULE__{pose: pose, width: w, height: h}, point) do
    {_, y, z} = Pose.transform_point(Pose.invert(pose), point)
    Pose.transform_point(pose, {0.0, clamp(y, w / 2), clamp(z, h / 2)})
  end

  @doc """
  Returns the 3D point of a pixel in an image of the given size that covers the rectangle, as seen against the normal.
  `{0, 0}` is the top left corner, `{width, height}` the bottom right corner.

      iex> wall = Situ.Rectangle3.new!(Situ.Pose.new({2.0, 0.0, 1.0}), 4, 2)
      iex> Situ.Rectangle3.from_pixel(wall, {0, 0}, {640, 480})
      {2.0, -2.0, 2.0}
      iex> Situ.Rectangle3.to_pixel(wall, {2.0, 1.0, 1.0}, {640, 480})
      {480.0, 240.0}
  """
  @spec from_pixel(t(), {number(), number()}, {pos_integer(), pos_integer()}) :: Vector3.t()
  def from_pixel(%__MODULE__{pose: pose} = rectangle, {px, py}, {width, height}) do
    y = (px / width - 0.5) * rectangle.width
    z = (0.5 - py / height) * rectangle.height
    Pose.transform_point(pose, {0.0, y, z})
  end

  @doc """
  Returns the pixel at a 3D point in an image of the given size that covers the rectangle. Returns `nil` if the point
  is more than `reach` (metres) away from the plane, if it is outside the rectangle, or if the rectangle has no area.
  """
  @spec to_pixel(t(), Vector3.t(), {pos_integer(), pos_integer()}, number()) ::
          {float(), float()} | nil
  def to_pixel(rectangle, point, size, reach \\ 0.01)
  def to_pixel(%__MODULE__{width: w, height: h}, _, _, _) when w == 0 or h == 0, do: nil

  def to_pixel(%__MODULE__{pose: pose} = rectangle, point, {width, height}, reach) do
    {x, y, z} = Pose.transform_point(Pose.invert(pose), point)
    {px, py} = {(y / rectangle.width + 0.5) * width, (0.5 - z / rectangle.height) * height}

    if abs(x) <= reach and px >= 0 and px <= width and py >= 0 and py <= height, do: {px, py}
  end

  defp clamp(value, half), do: value |> max(-half) |> min(half)
end

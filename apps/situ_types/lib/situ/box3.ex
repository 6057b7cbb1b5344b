defmodule Situ.Box3 do
  @moduledoc """
  A 3D box with bounds `min..max` (metres) in the frame of its pose.

      iex> box = Situ.Box3.new!({-1.0, -1.0, 0.0}, {1.0, 1.0, 2.0})
      iex> {Situ.Box3.center_point(box), Situ.Box3.volume(box), Situ.Box3.contains_point?(box, {0.5, 0.5, 2.0})}
      {{0.0, 0.0, 1.0}, 8.0, true}
  """
  alias Situ.{Error, Pose, Ray3, Rectangle3, Vector3}

  @enforce_keys [:min, :max]
  defstruct [:min, :max, pose: nil]

  @type t :: %__MODULE__{min: Vector3.t(), max: Vector3.t(), pose: Pose.t() | nil}
  @type facet :: :x_min | :x_max | :y_min | :y_max | :z_min | :z_max

  @doc """
  Builds a box. No coordinate of `min` may exceed its counterpart in `max`. Without a pose, the box is axis-aligned.
  """
  @spec new(Vector3.t(), Vector3.t(), Pose.t() | nil) :: {:ok, t()} | {:error, Error.t()}
  def new({ax, ay, az} = min, {bx, by, bz} = max, pose \\ nil) do
    if ax <= bx and ay <= by and az <= bz,
      do: {:ok, %__MODULE__{min: min, max: max, pose: pose}},
      else:
        {:error,
         Error.new(
           :bad_box,
           "invalid box from #{inspect(min)} to #{inspect(max)}: each minimum must be at most the maximum"
         )}
  end

  @doc "Like `new/3`, but returns the box or raises the error."
  @spec new!(Vector3.t(), Vector3.t(), Pose.t() | nil) :: t()
  def new!(min, max, pose \\ nil), do: min |> new(max, pose) |> Error.unwrap!()

  @doc "Returns the smallest axis-aligned box around the points, or `nil` for an empty list."
  @spec from_points([Vector3.t()]) :: t() | nil
  def from_points([]), do: nil

  def from_points(points) do
    {xs, ys, zs} = unzip_coordinates(points)

    %__MODULE__{
      min: {Enum.min(xs), Enum.min(ys), Enum.min(zs)},
      max: {Enum.max(xs), Enum.max(ys), Enum.max(zs)}
    }
  end

  defp unzip_coordinates(points),
    do:
      {Enum.map(points, &elem(&1, 0)), Enum.map(points, &elem(&1, 1)),
       Enum.map(points, &elem(&1, 2))}

  @doc "Returns the side lengths along the axes of the box (metres)."
  @spec axis_lengths(t()) :: Vector3.t()
  def axis_lengths(%__MODULE__{} = box), do: Vector3.subtract(box.max, box.min)

  @doc "Returns the volume (cubic metres)."
  @spec volume(t()) :: float()
  def volume(%__MODULE__{} = box) do
    {x, y, z} = axis_lengths(box)
    x * y * z
  end

  @doc "Returns whether at least one side length is 0."
  @spec degenerate?(t()) :: boolean()
  def degenerate?(box), do: volume(box) == 0

  @doc "Returns the center in the outer frame."
  @spec center_point(t()) :: Vector3.t()
  def center_point(%__MODULE__{} = box),
    do: to_outer_frame(box, Vector3.lerp(box.min, box.max, 0.5))

  @doc "Returns the eight corners in the outer frame. The x coordinate varies fastest, z slowest."
  @spec corner_points(t()) :: [Vector3.t()]
  def corner_points(%__MODULE__{min: {ax, ay, az}, max: {bx, by, bz}} = box) do
    for z <- [az, bz], y <- [ay, by], x <- [ax, bx], do: to_outer_frame(box, {x, y, z})
  end

  @facets [:x_min, :x_max, :y_min, :y_max, :z_min, :z_max]

  @doc "Lists the names of the six facets."
  @spec facet_names() :: [facet()]
  def facet_names, do: @facets

  @doc """
  Returns one facet as a rectangle in the outer frame. Its normal points out of the box.

      iex> box = Situ.Box3.new!({0.0, 0.0, 0.0}, {1.0, 2.0, 3.0})
      iex> front = Situ.Box3.facet_rectangle(box, :x_max)
      iex> {front.pose.position, front.width, front.height, Situ.Rectangle3.containing_plane(front).normal}
      {{1.0, 1.0, 1.5}, 2.0, 3.0, {1.0, 0.0, 0.0}}
  """
  @spec facet_rectangle(t(), facet()) :: Rectangle3.t()
  def facet_rectangle(%__MODULE__{min: {ax, ay, az}, max: {bx, by, bz}} = box, name)
      when name in @facets do
    {x, y, z} = Vector3.lerp(box.min, box.max, 0.5)
    {wide, deep, high} = axis_lengths(box)
    {up, side} = {{0.0, 0.0, 1.0}, {1.0, 0.0, 0.0}}

    {at, normal, up, width, height} =
      case name do
        :x_min -> {{ax, y, z}, {-1.0, 0.0, 0.0}, up, deep, high}
        :x_max -> {{bx, y, z}, {1.0, 0.0, 0.0}, up, deep, high}
        :y_min -> {{x, ay, z}, {0.0, -1.0, 0.0}, up, wide, high}
        :y_max -> {{x, by, z}, {0.0, 1.0, 0.0}, up, wide, high}
        :z_min -> {{x, y, az}, {0.0, 0.0, -1.0}, side, deep, wide}
        :z_max -> {{x, y, bz}, {0.0, 0.0, 1.0}, side, deep, wide}
      end

    {:ok, pose} = Pose.look_along(at, normal, up)
    pose = if box.pose, do: Pose.compose(box.pose, pose), else: pose
    Rectangle3.new!(pose, width, height)
  end

  @doc "Returns whether a point is in the box or at most `epsilon` (metres) outside it."
  @spec contains_point?(t(), Vector3.t(), number()) :: boolean()
  def contains_point?(
        %__MODULE__{min: {ax, ay, az}, max: {bx, by, bz}} = box,
        point,
        epsilon \\ 0
      ) do
    {x, y, z} = to_box_frame(box, point)

    x >= ax - epsilon and x <= bx + epsilon and y >= ay - epsilon and y <= by + epsilon and
      z >= az - epsilon and z <= bz + epsilon
  end

  @doc "Returns the point of the box nearest to `point`; a point inside the box is returned unchanged."
  @spec closest_point(t(), Vector3.t()) :: Vector3.t()
  def closest_point(%__MODULE__{min: {ax, ay, az}, max: {bx, by, bz}} = box, point) do
    {x, y, z} = to_box_frame(box, point)
    to_outer_frame(box, {clamp(x, ax, bx), clamp(y, ay, by), clamp(z, az, bz)})
  end

  @doc """
  Returns the point where a ray enters the box and the facet it crosses, or `nil` if it misses. A ray that starts
  inside the box returns the point where it leaves.

      iex> box = Situ.Box3.new!({1.0, -1.0, -1.0}, {3.0, 1.0, 1.0})
      iex> {:ok, ray} = Situ.Ray3.new({0.0, 0.0, 0.0}, {1.0, 0.0, 0.0})
      iex> Situ.Box3.intersect_ray(box, ray)
      {{1.0, 0.0, 0.0}, :x_min}
  """
  @spec intersect_ray(t(), Ray3.t()) :: {Vector3.t(), facet()} | nil
  def intersect_ray(%__MODULE__{} = box, %Ray3{} = ray) do
    local = if box.pose, do: Ray3.transform(ray, Pose.invert(box.pose)), else: ray

    slabs =
      for {axis, name} <- [{0, :x}, {1, :y}, {2, :z}],
          do:
            slab_crossing(
              elem(local.origin, axis),
              elem(local.direction, axis),
              elem(box.min, axis),
              elem(box.max, axis),
              name
            )

    if :miss not in slabs do
      {enter, entry} = slabs |> Enum.map(&elem(&1, 0)) |> Enum.max_by(&elem(&1, 0))
      {leave, exit} = slabs |> Enum.map(&elem(&1, 1)) |> Enum.min_by(&elem(&1, 0))

      cond do
        enter > leave or leave < 0 -> nil
        enter >= 0 -> {to_outer_frame(box, Ray3.point_at(local, enter)), entry}
        true -> {to_outer_frame(box, Ray3.point_at(local, leave)), exit}
      end
    end
  end

  # Returns the distances along the ray at which it enters and leaves the slab between two opposite facets. A ray
  # parallel to the slab is inside it everywhere or nowhere.
  @far 1.0e300
  defp slab_crossing(origin, direction, low, high, name) when abs(direction) < 1.0e-15 do
    if origin >= low and origin <= high,
      do: {{-@far, facet_name(name, :min)}, {@far, facet_name(name, :max)}},
      else: :miss
  end

  defp slab_crossing(origin, direction, low, high, name) do
    {first, last} =
      {{(low - origin) / direction, facet_name(name, :min)},
       {(high - origin) / direction, facet_name(name, :max)}}

    if direction > 0, do: {first, last}, else: {last, first}
  end

  defp facet_name(:x, :min), do: :x_min
  defp facet_name(:x, :max), do: :x_max
  defp facet_name(:y, :min), do: :y_min
  defp facet_name(:y, :max), do: :y_max
  defp facet_name(:z, :min), do: :z_min
  defp facet_name(:z, :max), do: :z_max

  @doc "Transforms the box from the pose's local frame to the frame in which the pose is given."
  @spec transform(t(), Pose.t()) :: t()
  def transform(%__MODULE__{} = box, %Pose{} = pose),
    do: %{box | pose: if(box.pose, do: Pose.compose(pose, box.pose), else: pose)}

  @doc "Scales the box around its center."
  @spec scale_around(t(), number()) :: t()
  def scale_around(%__MODULE__{} = box, factor) when is_number(factor) and factor >= 0 do
    middle = Vector3.lerp(box.min, box.max, 0.5)

    %{
      box
      | min: Vector3.lerp(middle, box.min, factor),
        max: Vector3.lerp(middle, box.max, factor)
    }
  end

  defp to_box_frame(%{pose: nil}, point), do: point
  defp to_box_frame(%{pose: pose}, point), do: Pose.transform_point(Pose.invert(pose), point)
  defp to_outer_frame(%{pose: nil}, point), do: point
  defp to_outer_frame(%{pose: pose}, point), do: Pose.transform_point(pose, point)
  defp clamp(value, low, high), do: value |> max(low) |> min(high)
end

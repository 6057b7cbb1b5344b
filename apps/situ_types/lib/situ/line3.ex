defmodule Situ.Line3 do
  @moduledoc """
  A line segment between two points (metres).

      iex> line = Situ.Line3.new({0.0, 0.0, 0.0}, {2.0, 0.0, 0.0})
      iex> {Situ.Line3.length(line), Situ.Line3.closest_point(line, {3.0, 1.0, 0.0})}
      {2.0, {2.0, 0.0, 0.0}}
  """
  alias Situ.{Pose, Vector3}

  @enforce_keys [:from, :to]
  defstruct [:from, :to]

  @type t :: %__MODULE__{from: Vector3.t(), to: Vector3.t()}

  @doc "Builds the line segment between two points."
  @spec new(Vector3.t(), Vector3.t()) :: t()
  def new({_, _, _} = from, {_, _, _} = to), do: %__MODULE__{from: from, to: to}

  @doc "Returns the length (metres)."
  @spec length(t()) :: float()
  def length(%__MODULE__{from: from, to: to}), do: Vector3.distance(from, to)

  @doc "Returns the point at a ratio of the length: 0 is the start, 1 is the end."
  @spec point_at_ratio(t(), number()) :: Vector3.t()
  def point_at_ratio(%__MODULE__{from: from, to: to}, ratio), do: Vector3.lerp(from, to, ratio)

  @doc "Returns the point of the line segment nearest to `point`."
  @spec closest_point(t(), Vector3.t()) :: Vector3.t()
  def closest_point(%__MODULE__{from: from, to: to} = line, point) do
    way = Vector3.subtract(to, from)
    square = Vector3.dot_product(way, way)

    if square == 0,
      do: from,
      else:
        point_at_ratio(
          line,
          clamp_ratio(Vector3.dot_product(Vector3.subtract(point, from), way) / square)
        )
  end

  defp clamp_ratio(ratio), do: ratio |> max(0.0) |> min(1.0)

  @doc "Transforms the line from the pose's local frame to the frame in which the pose is given."
  @spec transform(t(), Pose.t()) :: t()
  def transform(%__MODULE__{from: from, to: to}, %Pose{} = pose),
    do: new(Pose.transform_point(pose, from), Pose.transform_point(pose, to))
end

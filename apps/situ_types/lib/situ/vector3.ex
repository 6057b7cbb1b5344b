defmodule Situ.Vector3 do
  @moduledoc """
  Arithmetic on directions and displacements in space, as tuples `{x, y, z}` of floats.

  `Situ.Pose`, `Situ.Ray3` and the other 3D shapes hold tuples like these; `Situ.Point3` is a point struct for use in
  streams.

      iex> Situ.Vector3.cross_product({1.0, 0.0, 0.0}, {0.0, 1.0, 0.0})
      {0.0, 0.0, 1.0}
  """
  @type t :: {float(), float(), float()}

  @doc "Builds a vector of floats from three numbers."
  @spec new(number(), number(), number()) :: t()
  def new(x, y, z) when is_number(x) and is_number(y) and is_number(z),
    do: {x * 1.0, y * 1.0, z * 1.0}

  @doc "Adds two vectors."
  @spec add(t(), t()) :: t()
  def add({ax, ay, az}, {bx, by, bz}), do: {ax + bx, ay + by, az + bz}

  @doc "Subtracts `b` from `a`."
  @spec subtract(t(), t()) :: t()
  def subtract({ax, ay, az}, {bx, by, bz}), do: {ax - bx, ay - by, az - bz}

  @doc "Multiplies a vector by a number."
  @spec scale(t(), number()) :: t()
  def scale({x, y, z}, by), do: {x * by, y * by, z * by}

  @doc "Returns the dot product."
  @spec dot_product(t(), t()) :: float()
  def dot_product({ax, ay, az}, {bx, by, bz}), do: ax * bx + ay * by + az * bz

  @doc "Returns the right-handed cross product."
  @spec cross_product(t(), t()) :: t()
  def cross_product({ax, ay, az}, {bx, by, bz}),
    do: {ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx}

  @doc "Returns the length."
  @spec norm(t()) :: float()
  def norm(v), do: :math.sqrt(dot_product(v, v))

  @doc "Returns the Euclidean distance."
  @spec distance(t(), t()) :: float()
  def distance(a, b), do: a |> subtract(b) |> norm()

  @large 1.0e100

  @doc """
  Returns the unit vector in the same direction, or `:error` if the vector is too short (below 1e-12).

      iex> Situ.Vector3.normalize({0.0, 0.0, 2.0})
      {:ok, {0.0, 0.0, 1.0}}
      iex> Situ.Vector3.normalize({0.0, 0.0, 0.0})
      :error
      iex> Situ.Vector3.normalize({3.0e200, 0.0, -4.0e200})
      {:ok, {0.6000000000000001, 0.0, -0.8}}
  """
  @spec normalize(t()) :: {:ok, t()} | :error
  def normalize({x, y, z} = v) do
    case max(abs(x), max(abs(y), abs(z))) do
      # Squares of numbers this large would overflow.
      largest when largest > @large ->
        normalize_length({x / largest, y / largest, z / largest})

      _ ->
        normalize_length(v)
    end
  end

  defp normalize_length(v) do
    case norm(v) do
      length when length < 1.0e-12 -> :error
      length -> {:ok, scale(v, 1 / length)}
    end
  end

  @doc "Interpolates linearly from `a` (ratio 0) to `b` (ratio 1); other ratios extrapolate."
  @spec lerp(t(), t(), number()) :: t()
  def lerp({ax, ay, az}, {bx, by, bz}, ratio),
    do: {ax + (bx - ax) * ratio, ay + (by - ay) * ratio, az + (bz - az) * ratio}
end

defmodule Situ.Triangle3 do
  @moduledoc false
  # Calculations on triangles in space, which are tuples of three corners: containment, ray
  # intersection and nearest point. `Situ.Mesh` holds many triangles.
  alias Situ.{Ray3, Vector3}

  @type t :: {Vector3.t(), Vector3.t(), Vector3.t()}

  @doc "Returns whether a point is on the triangle, including its edges, or at most `epsilon` (metres) away from it."
  @spec contains_point?(t(), Vector3.t(), number()) :: boolean()
  def contains_point?(triangle, point, epsilon \\ 1.0e-6),
    do: Vector3.distance(closest_point(triangle, point), point) <= epsilon

  @doc """
  Returns the point of the triangle nearest to `p`. Source: C. Ericson, Real-Time Collision Detection, 2005, 5.1.5.

      iex> triangle = {{0.0, 0.0, 0.0}, {2.0, 0.0, 0.0}, {0.0, 2.0, 0.0}}
      iex> Situ.Triangle3.contains_point?(triangle, {0.5, 0.5, 0.0})
      true
      iex> Situ.Triangle3.closest_point(triangle, {-1.0, 1.0, 3.0})
      {0.0, 1.0, 0.0}
  """
  @spec closest_point(t(), Vector3.t()) :: Vector3.t()
  def closest_point({a, b, c}, p) do
    {ab, ac} = {Vector3.subtract(b, a), Vector3.subtract(c, a)}
    [d1, d2] = edge_products(ab, ac, Vector3.subtract(p, a))
    [d3, d4] = edge_products(ab, ac, Vector3.subtract(p, b))
    [d5, d6] = edge_products(ab, ac, Vector3.subtract(p, c))
    {va, vb, vc} = {d3 * d6 - d5 * d4, d5 * d2 - d1 * d6, d1 * d4 - d3 * d2}

    cond do
      d1 <= 0 and d2 <= 0 -> a
      d3 >= 0 and d4 <= d3 -> b
      d6 >= 0 and d5 <= d6 -> c
      vc <= 0 and d1 >= 0 and d3 <= 0 -> point_on_edge(a, b, d1, d1 - d3)
      vb <= 0 and d2 >= 0 and d6 <= 0 -> point_on_edge(a, c, d2, d2 - d6)
      va <= 0 and d4 >= d3 and d5 >= d6 -> point_on_edge(b, c, d4 - d3, d4 - d3 + d5 - d6)
      true -> point_inside(a, ab, ac, {va, vb, vc})
    end
  end

  defp edge_products(ab, ac, way),
    do: [Vector3.dot_product(ab, way), Vector3.dot_product(ac, way)]

  # The nearest point on an edge of length 0 is its start.
  defp point_on_edge(from, _to, _way, length) when length == 0, do: from
  defp point_on_edge(from, to, way, length), do: Vector3.lerp(from, to, way / length)

  defp point_inside(a, ab, ac, {va, vb, vc}) do
    all = va + vb + vc
    a |> Vector3.add(Vector3.scale(ab, vb / all)) |> Vector3.add(Vector3.scale(ac, vc / all))
  end

  @doc """
  Returns the distance (metres) along a ray to the triangle, from either side, or `nil` if the ray misses or is
  parallel. Source: T. Moeller, B. Trumbore, Fast, Minimum Storage Ray/Triangle Intersection, 1997.

      iex> {:ok, ray} = Situ.Ray3.new({0.5, 0.5, 3.0}, {0.0, 0.0, -1.0})
      iex> Situ.Triangle3.ray_distance({{0.0, 0.0, 0.0}, {2.0, 0.0, 0.0}, {0.0, 2.0, 0.0}}, ray)
      3.0
  """
  @spec ray_distance(t(), Ray3.t()) :: float() | nil
  def ray_distance({a, b, c}, %Ray3{origin: origin, direction: direction}) do
    {ab, ac} = {Vector3.subtract(b, a), Vector3.subtract(c, a)}
    across = Vector3.cross_product(direction, ac)
    determinant = Vector3.dot_product(ab, across)

    # The limit is relative to the size of the triangle so that rays hit small triangles, too.
    if abs(determinant) > 1.0e-12 * Vector3.norm(ab) * Vector3.norm(ac) do
      from = Vector3.subtract(origin, a)
      u = Vector3.dot_product(from, across) / determinant
      turned = Vector3.cross_product(from, ab)
      v = Vector3.dot_product(direction, turned) / determinant
      far = Vector3.dot_product(ac, turned) / determinant
      if u >= -1.0e-9 and v >= -1.0e-9 and u + v <= 1 + 1.0e-9 and far >= 0, do: far
    end
  end
end

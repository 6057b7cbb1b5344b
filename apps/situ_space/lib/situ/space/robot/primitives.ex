defmodule Situ.Space.Robot.Primitives do
  @moduledoc false
  # Builds boxes, cylinders and spheres around the origin, as triangles.
  alias Situ.Mesh

  # The number of segments around a cylinder or a sphere, and from pole to pole of a sphere.
  @around 32
  @rings 16

  @spec box({number(), number(), number()}) :: Mesh.t()
  def box({x, y, z}) do
    corners = for k <- [-z / 2, z / 2], j <- [-y / 2, y / 2], i <- [-x / 2, x / 2], do: {i, j, k}

    sides = [{0, 2, 3, 1}, {4, 5, 7, 6}, {0, 1, 5, 4}, {2, 6, 7, 3}, {0, 4, 6, 2}, {1, 3, 7, 5}]
    build_mesh(corners, Enum.flat_map(sides, fn {a, b, c, d} -> [{a, b, c}, {a, c, d}] end))
  end

  @doc "Builds a cylinder along the z axis."
  @spec cylinder(number(), number()) :: Mesh.t()
  def cylinder(radius, length) do
    ends =
      for z <- [-length / 2, length / 2], angle <- ring_angles(), do: ring_point(angle, radius, z)

    caps = [{0.0, 0.0, -length / 2}, {0.0, 0.0, length / 2}]

    triangles =
      for i <- 0..(@around - 1), j = rem(i + 1, @around) do
        {low, high} = {@around, @around + 1}

        [{i, j, j + low}, {i, j + low, i + low}] ++
          [{j, i, 2 * low}, {i + low, j + low, low + high}]
      end

    build_mesh(ends ++ caps, List.flatten(triangles))
  end

  @spec sphere(number()) :: Mesh.t()
  def sphere(radius) do
    points =
      for r <- 0..@rings, angle <- ring_angles() do
        tilt = :math.pi() * r / @rings
        ring_point(angle, radius * :math.sin(tilt), -radius * :math.cos(tilt))
      end

    triangles =
      for r <- 0..(@rings - 1), i <- 0..(@around - 1) do
        {a, b} = {r * @around + i, r * @around + rem(i + 1, @around)}
        [{a, b, b + @around}, {a, b + @around, a + @around}]
      end

    build_mesh(points, List.flatten(triangles))
  end

  defp ring_angles, do: for(i <- 0..(@around - 1), do: 2 * :math.pi() * i / @around)

  defp ring_point(angle, radius, z),
    do: {radius * :math.cos(angle), radius * :math.sin(angle), z / 1}

  defp build_mesh(points, triangles),
    do: points |> Mesh.from_lists(triangles) |> Situ.Error.unwrap!()
end

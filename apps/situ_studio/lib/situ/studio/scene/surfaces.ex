defmodule Situ.Studio.Scene.Surfaces do
  @moduledoc false
  # Converts point clouds, meshes, voxels and flat surfaces to items.
  alias Situ.{Mesh, Plane, PointCloud, Pose, Rectangle3, Vector3, VoxelGrid}
  alias Situ.Space.Cloud
  alias Situ.Studio.Draw.Picture
  alias Situ.Studio.{Frame, Scene}

  @type result :: {:ok, Scene.item()} | {:error, String.t()}
  @most_voxels 200_000

  @spec cloud(PointCloud.t(), String.t() | nil, map()) :: result()
  def cloud(%PointCloud{points: points, colors: colors}, _label, _settings)
      when not is_binary(points) or (colors != nil and not is_binary(colors)),
      do: {:error, "a point cloud whose points are not a binary"}

  # Clouds decoded as terms may come from a version without `values`.
  def cloud(cloud, label, settings) when not is_map_key(cloud, :values),
    do: cloud(Map.put(cloud, :values, nil), label, settings)

  def cloud(%PointCloud{values: values}, _label, _settings)
      when values != nil and not is_binary(values),
      do: {:error, "a point cloud whose values are not a binary"}

  def cloud(%PointCloud{} = cloud, label, settings) do
    with {:ok, {cloud, count}} <- some(cloud, PointCloud.count(cloud), settings),
         {:ok, cloud} <- PointCloud.new(cloud.points, cloud.colors, cloud.values) do
      meta = %{"of" => count, "name" => label || "point"}

      extras =
        for {name, bytes} <- [color: cloud.colors, value: cloud.values], bytes, do: {name, bytes}

      numbers = [{:position, cloud.points} | extras]
      {:ok, Scene.item(:points, PointCloud.count(cloud), numbers, meta)}
    else
      {:error, error} -> {:error, "an invalid point cloud: #{error.what}"}
    end
  end

  defp some(cloud, _count, %{within: [_ | _] = planes, budget: budget}),
    do: Cloud.within(cloud, planes, budget)

  defp some(cloud, count, %{budget: budget}) when count > budget do
    with {:ok, cloud} <- Cloud.thin(cloud, budget), do: {:ok, {cloud, count}}
  end

  defp some(cloud, count, _settings), do: {:ok, {cloud, count}}

  @spec mesh(Mesh.t(), String.t() | nil) :: result()
  def mesh(%Mesh{vertices: vertices, indices: indices} = mesh, label)
      when is_binary(vertices) and is_binary(indices) and rem(byte_size(vertices), 12) == 0 and
             rem(byte_size(indices), 12) == 0 do
    meta = %{"name" => label || "mesh"}
    meta = if mesh.pose, do: Map.put(meta, "matrix", columns(mesh.pose)), else: meta
    numbers = [position: vertices, index: indices]
    {:ok, Scene.item(:meshes, Mesh.triangle_count(mesh), numbers, meta)}
  end

  def mesh(_mesh, _label),
    do: {:error, "a mesh whose bytes are not complete vertices and triangles"}

  # WebGL stores matrices column by column.
  defp columns(pose) do
    [a, b, c, x, d, e, f, y, g, h, i, z | _] = Pose.to_matrix(pose)
    [a, d, g, 0, b, e, h, 0, c, f, i, 0, x, y, z, 1]
  end

  @spec voxels(VoxelGrid.t(), String.t() | nil, number()) :: result()
  def voxels(%VoxelGrid{size: size, voxels: voxels} = grid, label, threshold)
      when is_number(size) and size > 0 and is_map(voxels) do
    shown = for {index, value} <- Enum.sort(voxels), above?(value, threshold), do: {index, value}

    if length(shown) > @most_voxels do
      {:error, "#{length(shown)} voxels exceed the limit of #{@most_voxels}"}
    else
      position =
        Enum.flat_map(shown, fn {i, _} -> grid |> VoxelGrid.center(i) |> Tuple.to_list() end)

      values = Enum.map(shown, fn {_, value} -> number(value) end)
      numbers = [position: Scene.floats(position), value: Scene.floats(values)]

      {:ok,
       Scene.item(:voxels, length(shown), numbers, %{"size" => size, "name" => label || "voxel"})}
    end
  end

  def voxels(_grid, _label, _threshold), do: {:error, "a voxel grid without a size"}

  defp above?(value, threshold) when is_number(value), do: value > threshold
  defp above?(value, _threshold), do: value not in [nil, false]

  defp number(value) when is_number(value), do: value
  defp number(_value), do: 1

  @spec plain([Vector3.t()], String.t()) :: Scene.item()
  def plain(corners, name), do: quad(corners, %{"names" => [name]}, [])

  # Planes are infinite, so this draws a square with sides of two metres around the point nearest to the origin.
  @spec plane(Plane.t(), String.t()) :: Scene.item()
  def plane(%Plane{normal: normal} = plane, name) do
    middle = Plane.project(plane, {0.0, 0.0, 0.0})
    {nx, _, _} = normal

    {:ok, side} =
      normal
      |> Vector3.cross(if(abs(nx) < 0.9, do: {1.0, 0.0, 0.0}, else: {0.0, 1.0, 0.0}))
      |> Vector3.normalize()

    up = Vector3.cross(side, normal)

    corners =
      for {s, u} <- [{-1, 1}, {1, 1}, {1, -1}, {-1, -1}],
          do:
            middle
            |> Vector3.add(Vector3.scale(side, s * 1.0))
            |> Vector3.add(Vector3.scale(up, u * 1.0))

    plain(corners, name)
  end

  @doc "Builds a text on a rectangle, or of a height around a pose, to be read against the normal (the x axis)."
  @spec text(String.t(), Pose.t() | Rectangle3.t(), number()) :: Scene.item()
  def text(text, %Pose{} = pose, height) do
    width = max(String.length(text), 1) * height * 0.6
    text(text, Rectangle3.new!(pose, width, height), height)
  end

  def text(text, %Rectangle3{} = rectangle, _height) do
    text = String.slice(text, 0, 200)
    quad(Rectangle3.corners(rectangle), %{"names" => [text], "text" => text}, [])
  end

  @spec picture(struct(), [Vector3.t()], map()) :: result()
  def picture(viewed, corners, meta \\ %{}) do
    with {:ok, {pixels, width, height, data, unit}} <- Picture.of(viewed) do
      picture = %{
        "pixels" => Frame.pixels(pixels),
        "width" => width,
        "height" => height,
        "unit" => unit
      }

      meta = Map.merge(%{"picture" => picture, "names" => ["picture"]}, meta)
      {:ok, quad(corners, meta, bytes: data)}
    end
  end

  defp quad(corners, meta, more) do
    numbers = [corner: Scene.floats(Enum.flat_map(corners, &Tuple.to_list/1))] ++ more
    Scene.item(:quads, 1, numbers, meta)
  end
end

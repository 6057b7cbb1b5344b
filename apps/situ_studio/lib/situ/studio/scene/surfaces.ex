defmodule Situ.Studio.Scene.Surfaces do
  @moduledoc false
  # Converts point clouds, meshes, voxels and flat surfaces to items.
  alias Situ.{Mesh, Plane, PointCloud, Pose, Rectangle3, Vector3, VoxelGrid}
  alias Situ.Space.Cloud
  alias Situ.Studio.Draw.BrowserImage
  alias Situ.Studio.{Frame, Scene}

  @type result :: {:ok, Scene.item()} | {:error, String.t()}
  @most_voxels 200_000

  @spec cloud_item(PointCloud.t(), String.t() | nil, map()) :: result()
  def cloud_item(%PointCloud{points: points, colors: colors}, _label, _settings)
      when not is_binary(points) or (colors != nil and not is_binary(colors)),
      do: {:error, "a point cloud whose points are not a binary"}

  # Clouds decoded as terms may come from a version without `values`.
  def cloud_item(cloud, label, settings) when not is_map_key(cloud, :values),
    do: cloud_item(Map.put(cloud, :values, nil), label, settings)

  def cloud_item(%PointCloud{values: values}, _label, _settings)
      when values != nil and not is_binary(values),
      do: {:error, "a point cloud whose values are not a binary"}

  def cloud_item(%PointCloud{} = cloud, label, settings) do
    with {:ok, {cloud, count}} <- limit_points(cloud, PointCloud.point_count(cloud), settings),
         {:ok, cloud} <- PointCloud.new(cloud.points, cloud.colors, cloud.values) do
      meta = %{"of" => count, "name" => label || "point"}

      extras =
        for {name, bytes} <- [color: cloud.colors, value: cloud.values], bytes, do: {name, bytes}

      numbers = [{:position, cloud.points} | extras]
      {:ok, Scene.new_item(:points, PointCloud.point_count(cloud), numbers, meta)}
    else
      {:error, error} -> {:error, "an invalid point cloud: #{error.what}"}
    end
  end

  defp limit_points(cloud, _count, %{within: [_ | _] = planes, budget: budget}),
    do: Cloud.clip_to_planes(cloud, planes, budget)

  defp limit_points(cloud, count, %{budget: budget}) when count > budget do
    with {:ok, cloud} <- Cloud.limit_points(cloud, budget), do: {:ok, {cloud, count}}
  end

  defp limit_points(cloud, count, _settings), do: {:ok, {cloud, count}}

  @spec mesh_item(Mesh.t(), String.t() | nil) :: result()
  def mesh_item(%Mesh{vertices: vertices, indices: indices} = mesh, label)
      when is_binary(vertices) and is_binary(indices) and rem(byte_size(vertices), 12) == 0 and
             rem(byte_size(indices), 12) == 0 do
    meta = %{"name" => label || "mesh"}
    meta = if mesh.pose, do: Map.put(meta, "matrix", column_major(mesh.pose)), else: meta
    numbers = [position: vertices, index: indices]
    {:ok, Scene.new_item(:meshes, Mesh.triangle_count(mesh), numbers, meta)}
  end

  def mesh_item(_mesh, _label),
    do: {:error, "a mesh whose bytes are not complete vertices and triangles"}

  # WebGL stores matrices column by column.
  defp column_major(pose) do
    [a, b, c, x, d, e, f, y, g, h, i, z | _] = Pose.to_matrix(pose)
    [a, d, g, 0, b, e, h, 0, c, f, i, 0, x, y, z, 1]
  end

  @spec voxel_item(VoxelGrid.t(), String.t() | nil, number()) :: result()
  def voxel_item(%VoxelGrid{size: size, voxels: voxels} = grid, label, threshold)
      when is_number(size) and size > 0 and is_map(voxels) do
    shown =
      for {index, value} <- Enum.sort(voxels),
          above_threshold?(value, threshold),
          do: {index, value}

    if length(shown) > @most_voxels do
      {:error, "#{length(shown)} voxels exceed the limit of #{@most_voxels}"}
    else
      position =
        Enum.flat_map(shown, fn {i, _} -> grid |> VoxelGrid.voxel_center(i) |> Tuple.to_list() end)

      values = Enum.map(shown, fn {_, value} -> number_or_one(value) end)
      numbers = [position: Scene.encode_floats(position), value: Scene.encode_floats(values)]

      {:ok,
       Scene.new_item(:voxels, length(shown), numbers, %{
         "size" => size,
         "name" => label || "voxel"
       })}
    end
  end

  def voxel_item(_grid, _label, _threshold), do: {:error, "a voxel grid without a size"}

  defp above_threshold?(value, threshold) when is_number(value), do: value > threshold
  defp above_threshold?(value, _threshold), do: value not in [nil, false]

  defp number_or_one(value) when is_number(value), do: value
  defp number_or_one(_value), do: 1

  @spec named_quad([Vector3.t()], String.t()) :: Scene.item()
  def named_quad(corners, name), do: build_quad(corners, %{"names" => [name]}, [])

  # Planes are infinite, so this draws a square with sides of two metres around the point nearest to the origin.
  @spec plane_item(Plane.t(), String.t()) :: Scene.item()
  def plane_item(%Plane{normal: normal} = plane, name) do
    middle = Plane.project_point(plane, {0.0, 0.0, 0.0})
    {nx, _, _} = normal

    {:ok, side} =
      normal
      |> Vector3.cross_product(if(abs(nx) < 0.9, do: {1.0, 0.0, 0.0}, else: {0.0, 1.0, 0.0}))
      |> Vector3.normalize()

    up = Vector3.cross_product(side, normal)

    corners =
      for {s, u} <- [{-1, 1}, {1, 1}, {1, -1}, {-1, -1}],
          do:
            middle
            |> Vector3.add(Vector3.scale(side, s * 1.0))
            |> Vector3.add(Vector3.scale(up, u * 1.0))

    named_quad(corners, name)
  end

  @doc "Builds a text on a rectangle, or of a height around a pose, to be read against the normal (the x axis)."
  @spec text_item(String.t(), Pose.t() | Rectangle3.t(), number()) :: Scene.item()
  def text_item(text, %Pose{} = pose, height) do
    width = max(String.length(text), 1) * height * 0.6
    text_item(text, Rectangle3.new!(pose, width, height), height)
  end

  def text_item(text, %Rectangle3{} = rectangle, _height) do
    text = String.slice(text, 0, 200)
    build_quad(Rectangle3.corner_points(rectangle), %{"names" => [text], "text" => text}, [])
  end

  @spec image_item(struct(), [Vector3.t()], map()) :: result()
  def image_item(viewed, corners, meta \\ %{}) do
    with {:ok, {pixels, width, height, data, unit}} <- BrowserImage.to_browser_image(viewed) do
      picture = %{
        "pixels" => Frame.pixel_code(pixels),
        "width" => width,
        "height" => height,
        "unit" => unit
      }

      meta = Map.merge(%{"picture" => picture, "names" => ["picture"]}, meta)
      {:ok, build_quad(corners, meta, bytes: data)}
    end
  end

  defp build_quad(corners, meta, more) do
    numbers = [corner: Scene.encode_floats(Enum.flat_map(corners, &Tuple.to_list/1))] ++ more
    Scene.new_item(:quads, 1, numbers, meta)
  end
end

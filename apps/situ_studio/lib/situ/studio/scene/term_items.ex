defmodule Situ.Studio.Scene.TermItems do
  @moduledoc false
  # Collects the drawable items of any term in space: poses, rays, boxes, point clouds, skeletons,
  # camera views and the like, alone or in lists, tuples and maps, with optional names.
  # See docs/adr/0121-a-scene-consists-of-nine-kinds-of-items.md.
  alias Situ.{Box3, CameraIntrinsics, CameraView, DepthImage, EncodedImage, Image, Line3, Mesh}
  alias Situ.{Plane, Point3, PointCloud, Pose, PoseVelocity, Ray3, Rectangle3, Skeleton, Vector3}
  alias Situ.{Velocity3, VoxelGrid}
  alias Situ.Studio.Scene
  alias Situ.Studio.Scene.{ItemCollector, Surfaces, Views}

  @limit 20_000
  @depth 8
  @shapes [Box3, CameraView, Line3, Mesh, Plane, Point3, PointCloud, Pose, PoseVelocity, Ray3] ++
            [Rectangle3, Skeleton, Velocity3, VoxelGrid]
  @pictures [Image, EncodedImage, DepthImage]

  @typedoc """
  `budget` is the maximum number of points of a cloud. `within` is `nil` or the planes around the requested part of the
  clouds (`Situ.Space.Cloud.clip_to_planes/3`); with planes, only clouds are returned. `depth_as` is how depth images
  are shown, using every `sparsity`-th pixel. `focal` is the focal length (pixels) of images without intrinsics. `axis`
  is the length of a pose's axes and `ray` the length of a ray (metres). Voxels above `threshold` are shown. `text` is
  the height (metres) of texts in the plane of their pose or rectangle, or `nil` if all texts face the viewer.
  """
  @type settings :: %{optional(atom()) => term()}

  @defaults %{
    budget: 1_000_000,
    within: nil,
    depth_as: "points",
    sparsity: 1,
    focal: 500,
    text: nil,
    axis: 0.2,
    ray: 1.0,
    threshold: 0.0
  }

  @doc "Returns the structs that are drawn in space."
  @spec spatial_structs() :: [module()]
  def spatial_structs, do: @shapes

  @doc "Returns whether `term` contains anything that is drawn in space."
  @spec any?(term()) :: boolean()
  def any?(term), do: any_spatial?(term, 0)

  defp any_spatial?(_term, @depth), do: false
  defp any_spatial?(%module{}, _) when module in @shapes, do: true
  defp any_spatial?(%_{}, _), do: false

  defp any_spatial?(%{nodes: nodes, edges: edges}, _) when is_map(nodes) and is_list(edges),
    do: nodes |> Map.values() |> Enum.take(16) |> Enum.any?(&valid_position?/1)

  defp any_spatial?(map, n) when is_map(map),
    do: map |> Map.values() |> Enum.take(16) |> any_spatial?(n + 1)

  defp any_spatial?([head | tail], n),
    do: any_spatial?(head, n + 1) or (is_list(tail) and any_element?(tail, n, 15))

  defp any_spatial?(tuple, n) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> any_spatial?(n + 1)

  defp any_spatial?(_, _), do: false

  defp valid_position?({x, y, z}), do: is_number(x) and is_number(y) and is_number(z)
  defp valid_position?(term), do: is_struct(term, Point3)

  defp any_element?([head | tail], n, left) when left > 0,
    do: any_spatial?(head, n + 1) or any_element?(tail, n, left - 1)

  defp any_element?(_, _, _), do: false

  @doc """
  Returns whether `term` is intentionally empty: `nil`, an empty list or map, or a container of such values.

      iex> Enum.map([nil, [], %{"left" => nil}, {"lamp", nil}, [1], "lamp"], &Situ.Studio.Scene.TermItems.empty_term?/1)
      [true, true, true, true, false, false]
  """
  @spec empty_term?(term()) :: boolean()
  def empty_term?(term), do: empty_term?(term, 0)

  defp empty_term?(_term, @depth), do: false
  defp empty_term?(none, _) when none in [nil, []], do: true
  defp empty_term?(%_{}, _), do: false
  defp empty_term?(map, n) when is_map(map), do: map |> Map.values() |> empty_term?(n + 1)
  defp empty_term?([head | tail], n), do: empty_term?(head, n + 1) and empty_term?(tail, n)

  defp empty_term?(tuple, n) when is_tuple(tuple) do
    parts = tuple |> Tuple.to_list() |> Enum.reject(&is_binary/1)
    parts != [] and empty_term?(parts, n + 1)
  end

  defp empty_term?(_term, _), do: false

  @doc """
  Returns the items of a term and descriptions of its problems.

      iex> alias Situ.Studio.Scene.TermItems
      iex> {[item], []} = TermItems.collect_items([Situ.Point3.new(1, 2, 3), Situ.Point3.new(4, 5, 6)])
      iex> {item.kind, item.count}
      {:graphs, 2}
      iex> TermItems.any?(%{name: "lamp", at: Situ.Pose.identity()})
      true
      iex> TermItems.any?([1, 2, 3])
      false
  """
  @spec collect_items(term(), settings()) :: {[Scene.item()], [String.t()]}
  def collect_items(term, settings \\ %{}) do
    settings = Map.merge(@defaults, settings)

    {items, problems} =
      term
      |> collect_term(nil, {ItemCollector.new(@limit), settings}, 0)
      |> elem(0)
      |> ItemCollector.to_items()

    if settings.within,
      do: {Enum.filter(items, &(&1.kind == :points)), problems},
      else: {items, problems}
  end

  defp collect_term(_, _, {%{left: left}, _} = acc, _) when left <= 0, do: acc
  defp collect_term(_, _, acc, @depth), do: acc

  # Some tuples of several terms describe a single object.
  defp collect_term({%Image{} = i, %CameraIntrinsics{} = c, %Pose{} = p}, _, acc, _),
    do: add_view(i, c, p, acc)

  defp collect_term({%EncodedImage{} = i, %CameraIntrinsics{} = c, %Pose{} = p}, _, acc, _),
    do: add_view(i, c, p, acc)

  defp collect_term({%DepthImage{} = d, %CameraIntrinsics{} = c, %Pose{} = p}, _, acc, _),
    do: add_view(d, c, p, acc)

  defp collect_term({%CameraIntrinsics{} = c, %Pose{} = p}, label, acc, _),
    do: update_gathered(acc, &ItemCollector.add_item(&1, Views.frustum_item(c, p, label)))

  defp collect_term({%picture{} = viewed, %Pose{} = pose}, _, {_, %{focal: focal}} = acc, _)
       when picture in @pictures,
       do: add_view(viewed, Views.assume_intrinsics(viewed, focal), pose, acc)

  defp collect_term({%Mesh{} = mesh, %Pose{} = pose}, label, acc, n),
    do: collect_term(Mesh.transform(mesh, pose), label, acc, n + 1)

  defp collect_term({%PointCloud{} = cloud, %Pose{} = pose}, _, {_, settings} = acc, _),
    do: add_result(acc, Views.cloud_item(cloud, pose, settings))

  defp collect_term({%picture{} = viewed, %Rectangle3{} = r}, _, acc, _)
       when picture in @pictures,
       do: add_result(acc, Surfaces.image_item(viewed, Rectangle3.corner_points(r)))

  defp collect_term({text, %shape{} = place}, _, {_, %{text: height}} = acc, _)
       when is_binary(text) and shape in [Pose, Rectangle3] and is_number(height),
       do:
         update_gathered(
           acc,
           &ItemCollector.add_item(&1, Surfaces.text_item(text, place, height))
         )

  defp collect_term({text, place}, _, acc, n) when is_binary(text),
    do: collect_term(place, text, acc, n + 1)

  defp collect_term({place, text}, _, acc, n) when is_binary(text) and not is_binary(place),
    do: collect_term(place, text, acc, n + 1)

  defp collect_term(%Point3{x: x, y: y, z: z}, label, acc, _),
    do: update_gathered(acc, &ItemCollector.add_node(&1, {x, y, z}, label))

  defp collect_term(%Pose{} = pose, label, {_, %{axis: length}} = acc, _) do
    {x, y, z} = Pose.axis_directions(pose)
    name = label || "pose"

    [{x, {224, 64, 64}, "x"}, {y, {64, 184, 80}, "y"}, {z, {72, 120, 240}, "z"}]
    |> Enum.reduce(acc, fn {axis, color, letter}, acc ->
      to = Vector3.add(pose.position, Vector3.scale(axis, length))

      update_gathered(
        acc,
        &ItemCollector.add_arrow(&1, pose.position, to, color, "#{name} #{letter}")
      )
    end)
    |> update_gathered(&ItemCollector.add_text(&1, pose.position, label))
  end

  defp collect_term(%Ray3{} = ray, label, {_, %{ray: length}} = acc, _),
    do:
      update_gathered(
        acc,
        &ItemCollector.add_arrow(&1, ray.origin, Ray3.point_at(ray, length), nil, label || "ray")
      )

  defp collect_term(%Line3{} = line, label, acc, _),
    do: update_gathered(acc, &ItemCollector.add_line(&1, line.from, line.to, label || "line"))

  defp collect_term(%PoseVelocity{pose: %Pose{position: at}} = v, label, acc, _) do
    acc
    |> update_gathered(
      &ItemCollector.add_arrow(&1, at, Vector3.add(at, v.linear), nil, label || "velocity")
    )
    |> update_gathered(
      &ItemCollector.add_arrow(&1, at, Vector3.add(at, v.angular), {150, 150, 160}, "turns")
    )
  end

  defp collect_term(%Velocity3{} = v, label, acc, _) do
    to = Vector3.add(v.origin, Vector3.scale(v.direction, v.magnitude))
    update_gathered(acc, &ItemCollector.add_arrow(&1, v.origin, to, nil, label || "velocity"))
  end

  defp collect_term(%Box3{} = box, label, acc, _),
    do: update_gathered(acc, &ItemCollector.add_box(&1, box, label))

  defp collect_term(%Rectangle3{} = r, label, acc, _),
    do:
      update_gathered(
        acc,
        &ItemCollector.add_item(
          &1,
          Surfaces.named_quad(Rectangle3.corner_points(r), label || "rectangle")
        )
      )

  defp collect_term(%Plane{} = plane, label, acc, _),
    do:
      update_gathered(
        acc,
        &ItemCollector.add_item(&1, Surfaces.plane_item(plane, label || "plane"))
      )

  defp collect_term(%Mesh{} = mesh, label, acc, _),
    do: add_result(acc, Surfaces.mesh_item(mesh, label))

  defp collect_term(%PointCloud{} = cloud, label, {_, settings} = acc, _),
    do: add_result(acc, Surfaces.cloud_item(cloud, label, settings))

  defp collect_term(%VoxelGrid{} = grid, label, {_, settings} = acc, _),
    do: add_result(acc, Surfaces.voxel_item(grid, label, settings.threshold))

  defp collect_term(%Skeleton{} = body, label, acc, _),
    do: update_gathered(acc, &ItemCollector.add_skeleton(&1, body, label))

  defp collect_term(
         %CameraView{viewed: %PointCloud{} = cloud} = view,
         label,
         {_, settings} = acc,
         _
       ) do
    acc =
      update_gathered(
        acc,
        &ItemCollector.add_item(&1, Views.frustum_item(view.intrinsics, view.pose, label))
      )

    add_result(acc, Views.cloud_item(cloud, view.pose, settings))
  end

  defp collect_term(%CameraView{} = view, _, acc, _),
    do: add_view(view.viewed, view.intrinsics, view.pose, acc)

  defp collect_term(%_{}, _, acc, _), do: acc

  defp collect_term(%{nodes: nodes, edges: edges}, label, acc, _)
       when is_map(nodes) and is_list(edges),
       do: update_gathered(acc, &ItemCollector.add_graph(&1, nodes, edges, label))

  defp collect_term(map, _, acc, n) when is_map(map) do
    map
    |> Enum.sort()
    |> Enum.reduce(acc, fn {key, value}, acc ->
      collect_term(value, label_text(key), acc, n + 1)
    end)
  end

  defp collect_term([head | tail], label, acc, n),
    do: collect_tail(tail, label, collect_term(head, label, acc, n + 1), n)

  defp collect_term({x, y, z}, label, acc, _) when is_number(x) and is_number(y) and is_number(z),
    do: update_gathered(acc, &ItemCollector.add_node(&1, {x, y, z}, label))

  defp collect_term(tuple, label, acc, n) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> Enum.reduce(acc, &collect_term(&1, label, &2, n + 1))

  defp collect_term(_, _, acc, _), do: acc

  defp collect_tail([head | tail], label, acc, n),
    do: collect_tail(tail, label, collect_term(head, label, acc, n + 1), n)

  defp collect_tail(_, _, acc, _), do: acc

  defp update_gathered({gathered, settings}, fun), do: {fun.(gathered), settings}

  defp add_result(acc, {:ok, item}), do: update_gathered(acc, &ItemCollector.add_item(&1, item))

  defp add_result(acc, {:error, what}),
    do: update_gathered(acc, &ItemCollector.add_problem(&1, what))

  defp add_view(viewed, intrinsics, pose, {_, settings} = acc) do
    acc =
      update_gathered(acc, &ItemCollector.add_item(&1, Views.frustum_item(intrinsics, pose, nil)))

    add_result(acc, Views.view_item(CameraView.new(viewed, intrinsics, pose), settings))
  end

  defp label_text(key) when is_binary(key),
    do: if(String.valid?(key), do: String.slice(key, 0, 60), else: "?")

  defp label_text(key) when is_atom(key) or is_number(key), do: to_string(key)
  defp label_text(key), do: key |> inspect(limit: 5) |> String.slice(0, 60)
end

defmodule Situ.Studio.Scene.Terms do
  @moduledoc """
  Collects the drawable items of any term in space: poses, rays, boxes, point clouds, skeletons, camera views and the
  like, alone or in lists, tuples and maps, with optional names.

      iex> alias Situ.Studio.Scene.Terms
      iex> {[item], []} = Terms.of([Situ.Point3.new(1, 2, 3), Situ.Point3.new(4, 5, 6)])
      iex> {item.kind, item.count}
      {:graphs, 2}
      iex> Terms.any?(%{name: "lamp", at: Situ.Pose.identity()})
      true
      iex> Terms.any?([1, 2, 3])
      false
  """
  alias Situ.{Box3, CameraIntrinsics, CameraView, DepthImage, EncodedImage, Image, Line3, Mesh}
  alias Situ.{Plane, Point3, PointCloud, Pose, PoseVelocity, Ray3, Rectangle3, Skeleton, Vector3}
  alias Situ.{Velocity3, VoxelGrid}
  alias Situ.Studio.Scene
  alias Situ.Studio.Scene.{Gathered, Surfaces, Views}

  @limit 20_000
  @depth 8
  @shapes [Box3, CameraView, Line3, Mesh, Plane, Point3, PointCloud, Pose, PoseVelocity, Ray3] ++
            [Rectangle3, Skeleton, Velocity3, VoxelGrid]
  @pictures [Image, EncodedImage, DepthImage]

  @typedoc """
  `budget` is the maximum number of points of a cloud. `within` is `nil` or the planes around the requested part of the
  clouds (`Situ.Space.Cloud.within/3`); with planes, only clouds are returned. `depth_as` is how depth images are shown,
  using every `sparsity`-th pixel. `focal` is the focal length (pixels) of images without intrinsics. `axis` is the
  length of a pose's axes and `ray` the length of a ray (metres). Voxels above `threshold` are shown. `text` is the
  height (metres) of texts in the plane of their pose or rectangle, or `nil` if all texts face the viewer.
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
  @spec shapes() :: [module()]
  def shapes, do: @shapes

  @doc "Returns whether `term` contains anything that is drawn in space."
  @spec any?(term()) :: boolean()
  def any?(term), do: any?(term, 0)

  defp any?(_term, @depth), do: false
  defp any?(%module{}, _) when module in @shapes, do: true
  defp any?(%_{}, _), do: false

  defp any?(%{nodes: nodes, edges: edges}, _) when is_map(nodes) and is_list(edges),
    do: nodes |> Map.values() |> Enum.take(16) |> Enum.any?(&place?/1)

  defp any?(map, n) when is_map(map), do: map |> Map.values() |> Enum.take(16) |> any?(n + 1)
  defp any?([head | tail], n), do: any?(head, n + 1) or (is_list(tail) and some?(tail, n, 15))
  defp any?(tuple, n) when is_tuple(tuple), do: tuple |> Tuple.to_list() |> any?(n + 1)
  defp any?(_, _), do: false

  defp place?({x, y, z}), do: is_number(x) and is_number(y) and is_number(z)
  defp place?(term), do: is_struct(term, Point3)

  defp some?([head | tail], n, left) when left > 0,
    do: any?(head, n + 1) or some?(tail, n, left - 1)

  defp some?(_, _, _), do: false

  @doc """
  Returns whether `term` is intentionally empty: `nil`, an empty list or map, or a container of such values.

      iex> Enum.map([nil, [], %{"left" => nil}, {"lamp", nil}, [1], "lamp"], &Situ.Studio.Scene.Terms.nothing?/1)
      [true, true, true, true, false, false]
  """
  @spec nothing?(term()) :: boolean()
  def nothing?(term), do: nothing?(term, 0)

  defp nothing?(_term, @depth), do: false
  defp nothing?(none, _) when none in [nil, []], do: true
  defp nothing?(%_{}, _), do: false
  defp nothing?(map, n) when is_map(map), do: map |> Map.values() |> nothing?(n + 1)
  defp nothing?([head | tail], n), do: nothing?(head, n + 1) and nothing?(tail, n)

  defp nothing?(tuple, n) when is_tuple(tuple) do
    parts = tuple |> Tuple.to_list() |> Enum.reject(&is_binary/1)
    parts != [] and nothing?(parts, n + 1)
  end

  defp nothing?(_term, _), do: false

  @doc "Returns the items of a term and descriptions of its problems."
  @spec of(term(), settings()) :: {[Scene.item()], [String.t()]}
  def of(term, settings \\ %{}) do
    settings = Map.merge(@defaults, settings)

    {items, problems} =
      term |> walk(nil, {Gathered.new(@limit), settings}, 0) |> elem(0) |> Gathered.items()

    if settings.within,
      do: {Enum.filter(items, &(&1.kind == :points)), problems},
      else: {items, problems}
  end

  defp walk(_, _, {%{left: left}, _} = acc, _) when left <= 0, do: acc
  defp walk(_, _, acc, @depth), do: acc

  # Some tuples of several terms describe a single object.
  defp walk({%Image{} = i, %CameraIntrinsics{} = c, %Pose{} = p}, _, acc, _),
    do: view(i, c, p, acc)

  defp walk({%EncodedImage{} = i, %CameraIntrinsics{} = c, %Pose{} = p}, _, acc, _),
    do: view(i, c, p, acc)

  defp walk({%DepthImage{} = d, %CameraIntrinsics{} = c, %Pose{} = p}, _, acc, _),
    do: view(d, c, p, acc)

  defp walk({%CameraIntrinsics{} = c, %Pose{} = p}, label, acc, _),
    do: add(acc, &Gathered.item(&1, Views.frustum(c, p, label)))

  defp walk({%picture{} = viewed, %Pose{} = pose}, _, {_, %{focal: focal}} = acc, _)
       when picture in @pictures,
       do: view(viewed, Views.assumed(viewed, focal), pose, acc)

  defp walk({%Mesh{} = mesh, %Pose{} = pose}, label, acc, n),
    do: walk(Mesh.transform(mesh, pose), label, acc, n + 1)

  defp walk({%PointCloud{} = cloud, %Pose{} = pose}, _, {_, settings} = acc, _),
    do: found(acc, Views.cloud(cloud, pose, settings))

  defp walk({%picture{} = viewed, %Rectangle3{} = r}, _, acc, _) when picture in @pictures,
    do: found(acc, Surfaces.picture(viewed, Rectangle3.corners(r)))

  defp walk({text, %shape{} = place}, _, {_, %{text: height}} = acc, _)
       when is_binary(text) and shape in [Pose, Rectangle3] and is_number(height),
       do: add(acc, &Gathered.item(&1, Surfaces.text(text, place, height)))

  defp walk({text, place}, _, acc, n) when is_binary(text), do: walk(place, text, acc, n + 1)

  defp walk({place, text}, _, acc, n) when is_binary(text) and not is_binary(place),
    do: walk(place, text, acc, n + 1)

  defp walk(%Point3{x: x, y: y, z: z}, label, acc, _),
    do: add(acc, &Gathered.node(&1, {x, y, z}, label))

  defp walk(%Pose{} = pose, label, {_, %{axis: length}} = acc, _) do
    {x, y, z} = Pose.axes(pose)
    name = label || "pose"

    [{x, {224, 64, 64}, "x"}, {y, {64, 184, 80}, "y"}, {z, {72, 120, 240}, "z"}]
    |> Enum.reduce(acc, fn {axis, color, letter}, acc ->
      to = Vector3.add(pose.position, Vector3.scale(axis, length))
      add(acc, &Gathered.arrow(&1, pose.position, to, color, "#{name} #{letter}"))
    end)
    |> add(&Gathered.text(&1, pose.position, label))
  end

  defp walk(%Ray3{} = ray, label, {_, %{ray: length}} = acc, _),
    do: add(acc, &Gathered.arrow(&1, ray.origin, Ray3.point_at(ray, length), nil, label || "ray"))

  defp walk(%Line3{} = line, label, acc, _),
    do: add(acc, &Gathered.line(&1, line.from, line.to, label || "line"))

  defp walk(%PoseVelocity{pose: %Pose{position: at}} = v, label, acc, _) do
    acc
    |> add(&Gathered.arrow(&1, at, Vector3.add(at, v.linear), nil, label || "velocity"))
    |> add(&Gathered.arrow(&1, at, Vector3.add(at, v.angular), {150, 150, 160}, "turns"))
  end

  defp walk(%Velocity3{} = v, label, acc, _) do
    to = Vector3.add(v.origin, Vector3.scale(v.direction, v.magnitude))
    add(acc, &Gathered.arrow(&1, v.origin, to, nil, label || "velocity"))
  end

  defp walk(%Box3{} = box, label, acc, _), do: add(acc, &Gathered.box(&1, box, label))

  defp walk(%Rectangle3{} = r, label, acc, _),
    do: add(acc, &Gathered.item(&1, Surfaces.plain(Rectangle3.corners(r), label || "rectangle")))

  defp walk(%Plane{} = plane, label, acc, _),
    do: add(acc, &Gathered.item(&1, Surfaces.plane(plane, label || "plane")))

  defp walk(%Mesh{} = mesh, label, acc, _), do: found(acc, Surfaces.mesh(mesh, label))

  defp walk(%PointCloud{} = cloud, label, {_, settings} = acc, _),
    do: found(acc, Surfaces.cloud(cloud, label, settings))

  defp walk(%VoxelGrid{} = grid, label, {_, settings} = acc, _),
    do: found(acc, Surfaces.voxels(grid, label, settings.threshold))

  defp walk(%Skeleton{} = body, label, acc, _), do: add(acc, &Gathered.skeleton(&1, body, label))

  defp walk(%CameraView{viewed: %PointCloud{} = cloud} = view, label, {_, settings} = acc, _) do
    acc = add(acc, &Gathered.item(&1, Views.frustum(view.intrinsics, view.pose, label)))
    found(acc, Views.cloud(cloud, view.pose, settings))
  end

  defp walk(%CameraView{} = view, _, acc, _),
    do: view(view.viewed, view.intrinsics, view.pose, acc)

  defp walk(%_{}, _, acc, _), do: acc

  defp walk(%{nodes: nodes, edges: edges}, label, acc, _) when is_map(nodes) and is_list(edges),
    do: add(acc, &Gathered.graph(&1, nodes, edges, label))

  defp walk(map, _, acc, n) when is_map(map) do
    map
    |> Enum.sort()
    |> Enum.reduce(acc, fn {key, value}, acc -> walk(value, name(key), acc, n + 1) end)
  end

  defp walk([head | tail], label, acc, n),
    do: walk_tail(tail, label, walk(head, label, acc, n + 1), n)

  defp walk({x, y, z}, label, acc, _) when is_number(x) and is_number(y) and is_number(z),
    do: add(acc, &Gathered.node(&1, {x, y, z}, label))

  defp walk(tuple, label, acc, n) when is_tuple(tuple),
    do: tuple |> Tuple.to_list() |> Enum.reduce(acc, &walk(&1, label, &2, n + 1))

  defp walk(_, _, acc, _), do: acc

  defp walk_tail([head | tail], label, acc, n),
    do: walk_tail(tail, label, walk(head, label, acc, n + 1), n)

  defp walk_tail(_, _, acc, _), do: acc

  defp add({gathered, settings}, fun), do: {fun.(gathered), settings}

  defp found(acc, {:ok, item}), do: add(acc, &Gathered.item(&1, item))
  defp found(acc, {:error, what}), do: add(acc, &Gathered.problem(&1, what))

  defp view(viewed, intrinsics, pose, {_, settings} = acc) do
    acc = add(acc, &Gathered.item(&1, Views.frustum(intrinsics, pose, nil)))
    found(acc, Views.seen(CameraView.new(viewed, intrinsics, pose), settings))
  end

  defp name(key) when is_binary(key),
    do: if(String.valid?(key), do: String.slice(key, 0, 60), else: "?")

  defp name(key) when is_atom(key) or is_number(key), do: to_string(key)
  defp name(key), do: key |> inspect(limit: 5) |> String.slice(0, 60)
end

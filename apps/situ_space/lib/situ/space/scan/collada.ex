defmodule Situ.Space.Scan.Collada do
  @moduledoc false
  # Parses Collada 1.4 and 1.5 by Khronos (`.dae`): every triangle of the scene, transformed by its node, in metres,
  # without materials, skins and animations.
  alias Situ.{Error, Mesh}
  alias Situ.Space.Scan.{Text, Turn}
  alias Situ.Space.Xml

  @most 50_000_000
  @most_bytes 100_000_000
  @deepest 64

  @doc """
  Returns the mesh of the complete scene, with z up. With `axes: :own` coordinates keep the file's axes, as robot files
  expect.
  """
  @spec read(binary(), keyword()) :: {:ok, Mesh.t()} | {:error, Error.t()}
  def read(bytes, opts \\ [])

  def read(bytes, _opts) when byte_size(bytes) > @most_bytes,
    do: bad("it has more than #{div(@most_bytes, 1_000_000)} MB of text; save it as .glb")

  def read(bytes, opts) do
    case Xml.tree(bytes, texts: true) do
      {:ok, {"COLLADA", _, _} = root} -> mesh(root, opts)
      {:ok, _} -> bad("its root element is not COLLADA")
      {:error, why} -> bad(why)
    end
  catch
    {:bad, why} -> bad(why)
  end

  defp bad(why),
    do: {:error, Error.new(:bad_file, "invalid Collada file", why: why)}

  defp no!(why), do: throw({:bad, why})

  defp mesh(root, opts) do
    known = %{
      "geometry" => library(root, "library_geometries", "geometry"),
      "node" => library(root, "library_nodes", "node"),
      "visual_scene" => library(root, "library_visual_scenes", "visual_scene")
    }

    shapes =
      for node <- all(scene(root, known), "node"),
          shape <- shapes(node, base(root, opts), known, 0),
          do: shape

    {vertices, indices, _} =
      Enum.reduce(shapes, {[], [], 0}, fn {mesh, matrix}, {vertices, indices, first} ->
        Enum.reduce(surfaces(mesh), {vertices, indices, first}, fn {places, triangles},
                                                                   {v, i, n} ->
          count = length(places)
          if n + count > @most, do: no!("it has more than #{@most} vertices")
          {[v, moved(places, matrix)], [i, numbered(triangles, n, count)], n + count}
        end)
      end)

    case IO.iodata_to_binary(indices) do
      "" -> no!("its scene has no surface")
      indices -> Mesh.new(IO.iodata_to_binary(vertices), indices)
    end
  end

  # Maps the ids in a library to their items. Nodes nested in other nodes are not included.
  defp library(root, name, kind) do
    for part <- all(root, name),
        {_, given, _} = item <- all(part, kind),
        id = given["id"],
        into: %{},
        do: {id, item}
  end

  defp scene(root, known) do
    scenes = known["visual_scene"]

    with scene when scene != nil <- one(root, "scene"),
         {_, given, _} <- one(scene, "instance_visual_scene"),
         %{} = scenes when map_size(scenes) > 0 <- scenes do
      named(scenes, given["url"], "scene")
    else
      _ -> scenes |> Map.values() |> List.first() || no!("it has no scene")
    end
  end

  defp named(items, "#" <> id, kind),
    do: items[id] || no!("it has no #{kind} with the id #{String.slice(id, 0, 60)}")

  defp named(_items, _url, kind), do: no!("a #{kind} is in another file")

  # Converts the file's unit to metres, and its axes to z up.
  defp base(root, opts) do
    asset = one(root, "asset") || {"asset", %{}, []}

    unit =
      with {_, %{"meter" => text}, _} <- one(asset, "unit"), do: number(text), else: (_ -> 1.0)

    up =
      with {_, %{text: text}, _} <- one(asset, "up_axis"),
           do: String.trim(text),
           else: (_ -> "Y_UP")

    scaled = Turn.scale({unit, unit, unit})

    case {opts[:axes], up} do
      {:own, _} -> scaled
      {_, "Y_UP"} -> Turn.both(Turn.around({1.0, 0.0, 0.0}, 90.0), scaled)
      {_, "X_UP"} -> Turn.both(Turn.around({0.0, 1.0, 0.0}, -90.0), scaled)
      _ -> scaled
    end
  end

  # Collects the meshes of a node and of its descendants, each with its matrix.
  defp shapes(_node, _outer, _known, @deepest),
    do: no!("its nodes are nested too deeply or form a cycle")

  defp shapes({"node", _, parts}, outer, known, depth) do
    matrix = Enum.reduce(parts, outer, &Turn.both(&2, local(&1)))

    Enum.flat_map(parts, fn
      {"node", _, _} = inner ->
        shapes(inner, matrix, known, depth + 1)

      {"instance_node", %{"url" => url}, _} ->
        known["node"] |> named(url, "node") |> shapes(matrix, known, depth + 1)

      {"instance_geometry", %{"url" => url}, _} ->
        for mesh <- all(named(known["geometry"], url, "geometry"), "mesh"), do: {mesh, matrix}

      _ ->
        []
    end)
  end

  defp local({"matrix", %{text: text}, _}), do: Turn.rows(numbers(text, 16))

  defp local({"translate", %{text: text}, _}),
    do: text |> numbers(3) |> List.to_tuple() |> Turn.move()

  defp local({"scale", %{text: text}, _}),
    do: text |> numbers(3) |> List.to_tuple() |> Turn.scale()

  defp local({"rotate", %{text: text}, _}) do
    [x, y, z, degrees] = numbers(text, 4)
    Turn.around({x, y, z}, degrees)
  end

  defp local(_other), do: Turn.none()

  # Returns the positions of each list of vertices in a mesh, with the triangles between them.
  defp surfaces({"mesh", _, parts} = mesh) do
    sources =
      for {_, %{"id" => id}, _} = source <- all(mesh, "source"), into: %{}, do: {id, source}

    for {"vertices", %{"id" => id}, _} = vertices <- parts do
      input = Enum.find(all(vertices, "input"), &match?({_, %{"semantic" => "POSITION"}, _}, &1))
      {_, given, _} = input || no!("its vertices have no positions")

      {places(named(sources, given["source"], "source")),
       Enum.flat_map(parts, &triangles(&1, "#" <> id))}
    end
  end

  defp places(source) do
    {_, %{text: text}, _} = one(source, "float_array") || no!("its positions are not numbers")

    accessor =
      with {_, _, _} = technique <- one(source, "technique_common"),
           {_, given, _} <- one(technique, "accessor"),
           do: given,
           else: (_ -> %{})

    stride = whole(accessor["stride"] || "3")
    if stride not in 3..64, do: no!("its positions do not have three numbers each")

    text
    |> numbers()
    |> Enum.drop(whole(accessor["offset"] || "0"))
    |> Enum.chunk_every(stride, stride, :discard)
    |> Enum.map(fn [x, y, z | _] -> {x, y, z} end)
  end

  defp triangles({kind, _, parts} = part, vertices)
       when kind in ["triangles", "polylist", "polygons", "tristrips", "trifans"] do
    inputs =
      for {_, given, _} <- all(part, "input"),
          do: {given["semantic"], given["source"], whole(given["offset"] || "0")}

    stride = inputs |> Enum.map(&elem(&1, 2)) |> Enum.max(fn -> 0 end) |> Kernel.+(1)
    if stride > 64, do: no!("its triangles have too many inputs")

    case Enum.find(inputs, &match?({"VERTEX", ^vertices, _}, &1)) do
      {_, _, offset} ->
        for {"p", %{text: text}, _} <- parts,
            t <- cut(kind, corners(text, stride, offset), part),
            do: t

      nil ->
        []
    end
  end

  defp triangles(_other, _vertices), do: []

  defp corners(text, stride, offset) do
    text
    |> String.split()
    |> Enum.map(&whole/1)
    |> Enum.drop(offset)
    |> Enum.take_every(stride)
  end

  defp cut("triangles", corners, _), do: Enum.chunk_every(corners, 3, 3, :discard)
  defp cut("polygons", corners, _), do: fan(corners)
  defp cut("trifans", corners, _), do: fan(corners)
  defp cut("tristrips", corners, _), do: Enum.chunk_every(corners, 3, 1, :discard)

  defp cut("polylist", corners, part) do
    {_, %{text: text}, _} =
      one(part, "vcount") || no!("a list of polygons does not state their numbers of corners")

    {polygons, _rest} =
      text
      |> String.split()
      |> Enum.map(&whole/1)
      |> Enum.map_reduce(corners, &Enum.split(&2, &1))

    Enum.flat_map(polygons, &fan/1)
  end

  defp fan([a | others]),
    do: Enum.zip_with(others, Enum.drop(others, 1), fn b, c -> [a, b, c] end)

  defp fan([]), do: []

  defp moved(places, matrix) do
    for place <- places, into: <<>> do
      {x, y, z} = Turn.of(matrix, place)
      if abs(x) + abs(y) + abs(z) > 1.0e30, do: no!("a vertex is out of range")
      <<x::little-float-32, y::little-float-32, z::little-float-32>>
    end
  end

  defp numbered(triangles, first, count) do
    for triangle <- triangles, corner <- triangle, into: <<>> do
      if corner >= count, do: no!("a triangle refers to a vertex that does not exist")
      <<corner + first::little-32>>
    end
  end

  defp all({_, _, parts}, name), do: for({^name, _, _} = part <- parts, do: part)
  defp one({_, _, parts}, name), do: List.keyfind(parts, name, 0)

  defp numbers(text, count) do
    list = numbers(text)
    if length(list) == count, do: list, else: no!("a node's transform must have #{count} numbers")
  end

  defp numbers(text), do: text |> String.split() |> Enum.map(&number/1)

  defp number(text) do
    case Text.float(text) do
      {:ok, x} when abs(x) < 1.0e12 -> x
      _ -> no!("#{inspect(String.slice(text, 0, 20))} is not a number in range")
    end
  end

  defp whole(text) do
    case Integer.parse(text) do
      {n, ""} when n in 0..0xFFFFFFFF -> n
      _ -> no!("#{inspect(String.slice(text, 0, 20))} is not a valid count or index")
    end
  end
end

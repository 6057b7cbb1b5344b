defmodule Situ.Space.GeometryFile.Collada do
  @moduledoc false
  # Parses Collada 1.4 and 1.5 by Khronos (`.dae`): every triangle of the scene, transformed by its node, in metres,
  # without materials, skins and animations.
  alias Situ.{Error, Mesh, Xml}
  alias Situ.Space.GeometryFile.{NumberParser, AffineTransform}

  @most 50_000_000
  @most_bytes 100_000_000
  @deepest 64

  @doc """
  Returns the mesh of the complete scene, with z up. With `axes: :own` coordinates keep the file's axes, as robot files
  expect.
  """
  @spec parse_file(binary(), keyword()) :: {:ok, Mesh.t()} | {:error, Error.t()}
  def parse_file(bytes, opts \\ [])

  def parse_file(bytes, _opts) when byte_size(bytes) > @most_bytes,
    do: file_error("it has more than #{div(@most_bytes, 1_000_000)} MB of text; save it as .glb")

  def parse_file(bytes, opts) do
    case Xml.parse(bytes) do
      {:ok, {"COLLADA", _, _} = root} -> build_mesh(root, opts)
      {:ok, _} -> file_error("its root element is not COLLADA")
      {:error, why} -> file_error(why)
    end
  catch
    {:bad, why} -> file_error(why)
  end

  defp file_error(why),
    do: {:error, Error.new(:bad_file, "invalid Collada file", why: why)}

  defp reject_file!(why), do: throw({:bad, why})

  defp build_mesh(root, opts) do
    known = %{
      "geometry" => library_items(root, "library_geometries", "geometry"),
      "node" => library_items(root, "library_nodes", "node"),
      "visual_scene" => library_items(root, "library_visual_scenes", "visual_scene")
    }

    shapes =
      for node <- Xml.list_children(find_scene!(root, known), "node"),
          shape <- collect_meshes(node, base_transform(root, opts), known, 0),
          do: shape

    {vertices, indices, _} =
      Enum.reduce(shapes, {[], [], 0}, fn {mesh, matrix}, {vertices, indices, first} ->
        Enum.reduce(mesh_surfaces(mesh), {vertices, indices, first}, fn {places, triangles},
                                                                        {v, i, n} ->
          count = length(places)
          if n + count > @most, do: reject_file!("it has more than #{@most} vertices")

          {[v, encode_vertices(places, matrix)], [i, encode_indices(triangles, n, count)],
           n + count}
        end)
      end)

    case IO.iodata_to_binary(indices) do
      "" -> reject_file!("its scene has no surface")
      indices -> Mesh.new(IO.iodata_to_binary(vertices), indices)
    end
  end

  # Maps the ids in a library to their items. Nodes nested in other nodes are not included.
  defp library_items(root, name, kind) do
    for part <- Xml.list_children(root, name),
        {_, given, _} = item <- Xml.list_children(part, kind),
        id = given["id"],
        into: %{},
        do: {id, item}
  end

  defp find_scene!(root, known) do
    scenes = known["visual_scene"]

    with scene when scene != nil <- Xml.find_child(root, "scene"),
         {_, given, _} <- Xml.find_child(scene, "instance_visual_scene"),
         %{} = scenes when map_size(scenes) > 0 <- scenes do
      fetch_by_url!(scenes, given["url"], "scene")
    else
      _ -> scenes |> Map.values() |> List.first() || reject_file!("it has no scene")
    end
  end

  defp fetch_by_url!(items, "#" <> id, kind),
    do: items[id] || reject_file!("it has no #{kind} with the id #{String.slice(id, 0, 60)}")

  defp fetch_by_url!(_items, _url, kind), do: reject_file!("a #{kind} is in another file")

  # Converts the file's unit to metres, and its axes to z up.
  defp base_transform(root, opts) do
    asset = Xml.find_child(root, "asset") || {"asset", %{}, []}

    unit =
      with {_, %{"meter" => text}, _} <- Xml.find_child(asset, "unit"),
           do: parse_number(text),
           else: (_ -> 1.0)

    up =
      if axis = Xml.find_child(asset, "up_axis"),
        do: String.trim(Xml.text_content(axis)),
        else: "Y_UP"

    scaled = AffineTransform.scaling({unit, unit, unit})

    case {opts[:axes], up} do
      {:own, _} ->
        scaled

      {_, "Y_UP"} ->
        AffineTransform.compose(AffineTransform.rotation_around({1.0, 0.0, 0.0}, 90.0), scaled)

      {_, "X_UP"} ->
        AffineTransform.compose(AffineTransform.rotation_around({0.0, 1.0, 0.0}, -90.0), scaled)

      _ ->
        scaled
    end
  end

  # Collects the meshes of a node and of its descendants, each with its matrix.
  defp collect_meshes(_node, _outer, _known, @deepest),
    do: reject_file!("its nodes are nested too deeply or form a cycle")

  defp collect_meshes({"node", _, parts}, outer, known, depth) do
    matrix = Enum.reduce(parts, outer, &AffineTransform.compose(&2, local_transform(&1)))

    Enum.flat_map(parts, fn
      {"node", _, _} = inner ->
        collect_meshes(inner, matrix, known, depth + 1)

      {"instance_node", %{"url" => url}, _} ->
        known["node"] |> fetch_by_url!(url, "node") |> collect_meshes(matrix, known, depth + 1)

      {"instance_geometry", %{"url" => url}, _} ->
        for mesh <- Xml.list_children(fetch_by_url!(known["geometry"], url, "geometry"), "mesh"),
            do: {mesh, matrix}

      _ ->
        []
    end)
  end

  defp local_transform({"matrix", _, _} = matrix),
    do: AffineTransform.from_rows(parse_vector(matrix, 16))

  defp local_transform({"translate", _, _} = translate),
    do: translate |> parse_vector(3) |> List.to_tuple() |> AffineTransform.translation()

  defp local_transform({"scale", _, _} = scale),
    do: scale |> parse_vector(3) |> List.to_tuple() |> AffineTransform.scaling()

  defp local_transform({"rotate", _, _} = rotate) do
    [x, y, z, degrees] = parse_vector(rotate, 4)
    AffineTransform.rotation_around({x, y, z}, degrees)
  end

  defp local_transform(_other), do: AffineTransform.identity()

  # Returns the positions of each list of vertices in a mesh, with the triangles between them.
  defp mesh_surfaces({"mesh", _, parts} = mesh) do
    sources =
      for {_, %{"id" => id}, _} = source <- Xml.list_children(mesh, "source"),
          into: %{},
          do: {id, source}

    for {"vertices", %{"id" => id}, _} = vertices <- parts do
      input =
        Enum.find(
          Xml.list_children(vertices, "input"),
          &match?({_, %{"semantic" => "POSITION"}, _}, &1)
        )

      {_, given, _} = input || reject_file!("its vertices have no positions")

      {source_positions(fetch_by_url!(sources, given["source"], "source")),
       Enum.flat_map(parts, &parse_triangles(&1, "#" <> id))}
    end
  end

  defp source_positions(source) do
    positions =
      Xml.find_child(source, "float_array") || reject_file!("its positions are not numbers")

    accessor =
      with {_, _, _} = technique <- Xml.find_child(source, "technique_common"),
           {_, given, _} <- Xml.find_child(technique, "accessor"),
           do: given,
           else: (_ -> %{})

    stride = parse_integer(accessor["stride"] || "3")
    if stride not in 3..64, do: reject_file!("its positions do not have three numbers each")

    positions
    |> parse_numbers()
    |> Enum.drop(parse_integer(accessor["offset"] || "0"))
    |> Enum.chunk_every(stride, stride, :discard)
    |> Enum.map(fn [x, y, z | _] -> {x, y, z} end)
  end

  defp parse_triangles({kind, _, parts} = part, vertices)
       when kind in ["triangles", "polylist", "polygons", "tristrips", "trifans"] do
    inputs =
      for {_, given, _} <- Xml.list_children(part, "input"),
          do: {given["semantic"], given["source"], parse_integer(given["offset"] || "0")}

    stride = inputs |> Enum.map(&elem(&1, 2)) |> Enum.max(fn -> 0 end) |> Kernel.+(1)
    if stride > 64, do: reject_file!("its triangles have too many inputs")

    case Enum.find(inputs, &match?({"VERTEX", ^vertices, _}, &1)) do
      {_, _, offset} ->
        for {"p", _, _} = indices <- parts,
            t <- split_polygons(kind, vertex_indices(indices, stride, offset), part),
            do: t

      nil ->
        []
    end
  end

  defp parse_triangles(_other, _vertices), do: []

  defp vertex_indices(indices, stride, offset) do
    indices
    |> parse_integers()
    |> Enum.drop(offset)
    |> Enum.take_every(stride)
  end

  defp split_polygons("triangles", corners, _), do: Enum.chunk_every(corners, 3, 3, :discard)
  defp split_polygons("polygons", corners, _), do: triangle_fan(corners)
  defp split_polygons("trifans", corners, _), do: triangle_fan(corners)
  defp split_polygons("tristrips", corners, _), do: Enum.chunk_every(corners, 3, 1, :discard)

  defp split_polygons("polylist", corners, part) do
    counts =
      Xml.find_child(part, "vcount") ||
        reject_file!("a list of polygons does not state their numbers of corners")

    {polygons, _rest} =
      counts |> parse_integers() |> Enum.map_reduce(corners, &Enum.split(&2, &1))

    Enum.flat_map(polygons, &triangle_fan/1)
  end

  defp triangle_fan([a | others]),
    do: Enum.zip_with(others, Enum.drop(others, 1), fn b, c -> [a, b, c] end)

  defp triangle_fan([]), do: []

  defp encode_vertices(places, matrix) do
    for place <- places, into: <<>> do
      {x, y, z} = AffineTransform.transform_point(matrix, place)
      if abs(x) + abs(y) + abs(z) > 1.0e30, do: reject_file!("a vertex is out of range")
      <<x::little-float-32, y::little-float-32, z::little-float-32>>
    end
  end

  defp encode_indices(triangles, first, count) do
    for triangle <- triangles, corner <- triangle, into: <<>> do
      if corner >= count, do: reject_file!("a triangle refers to a vertex that does not exist")
      <<corner + first::little-32>>
    end
  end

  defp parse_vector(element, count) do
    list = parse_numbers(element)

    if length(list) == count,
      do: list,
      else: reject_file!("a node's transform must have #{count} numbers")
  end

  defp parse_numbers(element), do: element |> split_words() |> Enum.map(&parse_number/1)
  defp parse_integers(element), do: element |> split_words() |> Enum.map(&parse_integer/1)
  defp split_words(element), do: element |> Xml.text_content() |> String.split()

  defp parse_number(text) do
    case NumberParser.parse_float(text) do
      {:ok, x} when abs(x) < 1.0e12 -> x
      _ -> reject_file!("#{inspect(String.slice(text, 0, 20))} is not a number in range")
    end
  end

  defp parse_integer(text) do
    case Integer.parse(text) do
      {n, ""} when n in 0..0xFFFFFFFF -> n
      _ -> reject_file!("#{inspect(String.slice(text, 0, 20))} is not a valid count or index")
    end
  end
end

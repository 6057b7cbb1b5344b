defmodule Situ.Space.GeometryFile.Gltf do
  @moduledoc false
  # Parses glTF 2.0 by Khronos: `.glb`, or `.gltf` with its bytes embedded or in files in the same folder. Reads every
  # triangle of the scene, transformed by its node, without materials, skins and animations. Its axes (y up, z forward)
  # are converted to ours (x forward, z up).
  import Situ.BinarySize, only: [pinned_size: 1]
  import Bitwise
  alias Situ.{Error, JSON, Mesh}

  @identity {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0}
  @most 50_000_000
  @numbers %{5121 => 1, 5123 => 2, 5125 => 4}

  # Required extensions that do not change positions, so that they can be ignored.
  @harmless ~r/\A(KHR_materials_|KHR_texture_|EXT_texture_|KHR_lights_|KHR_xmp|KHR_animation_)/
  @most_bytes 2_000_000_000

  @doc "Returns the mesh of the complete scene. `folder` contains the files that it refers to; `nil` allows no files."
  @spec parse_file(binary(), Path.t() | nil) :: {:ok, Mesh.t()} | {:error, Error.t()}
  def parse_file(bytes, folder \\ nil) do
    {json, body} = split_chunks(bytes)

    case JSON.decode(json) do
      {:ok, %{"asset" => %{"version" => "2." <> _}} = scene} ->
        scene |> ensure_supported() |> load_buffers(folder) |> build_mesh(body)

      {:ok, _} ->
        file_error("it is not glTF version 2")

      {:error, _} ->
        file_error("its description is not valid JSON")
    end
  catch
    {:bad, why} -> file_error(why)
  end

  defp file_error(why),
    do: {:error, Error.new(:bad_file, "invalid glTF file", why: why)}

  defp reject_file!(why), do: throw({:bad, why})

  defp split_chunks(
         <<"glTF", 2::little-32, _::32, n::little-32, "JSON", json::binary-size(n), rest::binary>>
       ) do
    case rest do
      <<n::little-32, "BIN", 0, body::binary-size(n), _::binary>> -> {json, body}
      _ -> {json, nil}
    end
  end

  defp split_chunks(<<"glTF", _::binary>>),
    do: reject_file!("its first chunk is cut off or has another version")

  defp split_chunks(text), do: {text, nil}

  defp ensure_supported(scene) do
    needs = scene["extensionsRequired"] || []
    if not is_list(needs), do: reject_file!("extensionsRequired is not a list")

    case Enum.reject(needs, &(is_binary(&1) and &1 =~ @harmless)) do
      [] ->
        scene

      needs ->
        reject_file!(
          "it requires #{inspect(needs, limit: 5, printable_limit: 200)}; save it without compression"
        )
    end
  end

  defp build_mesh(scene, body) do
    shapes = scene |> root_nodes() |> collect_meshes(scene, @identity, MapSet.new()) |> elem(0)

    parts =
      for {number, matrix} <- shapes,
          part <- ensure_maps(fetch_item!(scene, "meshes", number)["primitives"]),
          do: {part, matrix}

    {vertices, indices, _} =
      Enum.reduce(parts, {[], [], 0}, fn {part, matrix}, {vertices, indices, first} ->
        places = vertex_positions(part, scene, body)
        count = div(byte_size(places), 12)
        if first + count > @most, do: reject_file!("it has more than #{@most} vertices")

        {[vertices, transform_vertices(places, matrix)],
         [indices, encode_triangles(part, count, first, scene, body)], first + count}
      end)

    vertices = IO.iodata_to_binary(vertices)

    if vertices == "",
      do: reject_file!("its scene has no surface"),
      else: Mesh.new(vertices, IO.iodata_to_binary(indices))
  end

  defp root_nodes(scene) do
    case scene["scenes"] do
      list when is_list(list) and list != [] ->
        fetch_item!(scene, "scenes", scene["scene"] || 0)["nodes"] || []

      _ ->
        Enum.to_list(0..(length(ensure_maps(scene["nodes"])) - 1)//1)
    end
  end

  defp ensure_maps(nil), do: []

  defp ensure_maps(list) do
    if is_list(list) and Enum.all?(list, &is_map/1),
      do: list,
      else: reject_file!("a list of its scene is not a list of objects")
  end

  # Collects every mesh with its matrix. A node that occurs twice is an error, because it has two parents or is its
  # own descendant.
  defp collect_meshes(numbers, scene, outer, seen) when is_list(numbers) do
    Enum.reduce(numbers, {[], seen}, fn number, {shapes, seen} ->
      if number in seen, do: reject_file!("node #{inspect(number)} occurs twice in the scene")
      node = fetch_item!(scene, "nodes", number)
      matrix = multiply_matrices(outer, local_matrix(node))
      own = if node["mesh"], do: [{node["mesh"], matrix}], else: []

      {inner, seen} =
        collect_meshes(node["children"] || [], scene, matrix, MapSet.put(seen, number))

      {shapes ++ own ++ inner, seen}
    end)
  end

  defp collect_meshes(_other, _scene, _outer, _seen),
    do: reject_file!("a node's children are not a list")

  defp fetch_item!(scene, kind, number) when is_integer(number) and number >= 0 do
    case scene[kind] do
      list when is_list(list) -> Enum.at(list, number)
      _ -> nil
    end
    |> case do
      %{} = item -> item
      _ -> reject_file!("item #{number} of its #{kind} does not exist")
    end
  end

  defp fetch_item!(_scene, kind, number),
    do: reject_file!("#{inspect(number)} is not an index of its #{kind}")

  # glTF stores three columns and the translation.
  defp local_matrix(%{"matrix" => list}) do
    case parse_floats(list, 16) do
      [a, b, c, _, d, e, f, _, g, h, i, _, x, y, z, _] -> {a, b, c, d, e, f, g, h, i, x, y, z}
    end
  end

  defp local_matrix(node) do
    [x, y, z] = parse_floats(node["translation"] || [0, 0, 0], 3)
    [i, j, k, w] = parse_floats(node["rotation"] || [0, 0, 0, 1], 4)
    [sx, sy, sz] = parse_floats(node["scale"] || [1, 1, 1], 3)

    {sx * (1 - 2 * (j * j + k * k)), sx * 2 * (i * j + k * w), sx * 2 * (i * k - j * w),
     sy * 2 * (i * j - k * w), sy * (1 - 2 * (i * i + k * k)), sy * 2 * (j * k + i * w),
     sz * 2 * (i * k + j * w), sz * 2 * (j * k - i * w), sz * (1 - 2 * (i * i + j * j)), x, y, z}
  end

  defp parse_floats(list, count) do
    if is_list(list) and length(list) == count and
         Enum.all?(list, &(is_number(&1) and abs(&1) < 1.0e9)),
       do: Enum.map(list, &(&1 * 1.0)),
       else: reject_file!("a node's transform must have #{count} numbers")
  end

  defp multiply_matrices(m, {a, b, c, d, e, f, g, h, i, x, y, z}) do
    {a, b, c} = rotate_vector(m, a, b, c)
    {d, e, f} = rotate_vector(m, d, e, f)
    {g, h, i} = rotate_vector(m, g, h, i)
    {dx, dy, dz} = rotate_vector(m, x, y, z)

    {a, b, c, d, e, f, g, h, i, in_range(dx + elem(m, 9)), in_range(dy + elem(m, 10)),
     in_range(dz + elem(m, 11))}
  end

  defp rotate_vector({a, b, c, d, e, f, g, h, i, _, _, _}, x, y, z),
    do:
      {in_range(a * x + d * y + g * z), in_range(b * x + e * y + h * z),
       in_range(c * x + f * y + i * z)}

  # The factors of a deep tree could overflow.
  defp in_range(x) when abs(x) < 1.0e20, do: x
  defp in_range(_x), do: reject_file!("a node's transform is out of range")

  defp vertex_positions(part, scene, body) do
    with %{"attributes" => %{"POSITION" => number}} <- part,
         %{"componentType" => 5126, "type" => "VEC3"} = accessor <-
           fetch_item!(scene, "accessors", number) do
      read_elements(accessor, 12, scene, body)
    else
      _ -> reject_file!("a surface has no positions in 32-bit floats")
    end
  end

  defp transform_vertices(places, {a, b, c, d, e, f, g, h, i, x, y, z}) do
    moved =
      for <<px::little-float-32, py::little-float-32, pz::little-float-32 <- places>>,
          abs(px) + abs(py) + abs(pz) < 1.0e9,
          into: <<>> do
        right = a * px + d * py + g * pz + x
        up = b * px + e * py + h * pz + y
        forward = c * px + f * py + i * pz + z
        <<forward::little-float-32, right::little-float-32, up::little-float-32>>
      end

    if byte_size(moved) == byte_size(places),
      do: moved,
      else: reject_file!("a vertex has coordinates that are not finite")
  end

  defp encode_triangles(part, count, first, scene, body) do
    numbers =
      if part["indices"],
        do: read_indices(fetch_item!(scene, "accessors", part["indices"]), scene, body),
        else: Enum.to_list(0..(count - 1)//1)

    if Enum.any?(numbers, &(&1 >= count)),
      do: reject_file!("a triangle refers to a vertex that does not exist")

    case part["mode"] || 4 do
      4 -> Enum.chunk_every(numbers, 3, 3, :discard)
      5 -> triangle_strip(numbers)
      6 -> triangle_fan(numbers)
      _points_or_lines -> []
    end
    |> Enum.map(fn [a, b, c] ->
      <<a + first::little-32, b + first::little-32, c + first::little-32>>
    end)
  end

  defp triangle_strip(numbers) do
    numbers
    |> Enum.chunk_every(3, 1, :discard)
    |> Enum.with_index(fn [a, b, c], i -> if (i &&& 1) == 0, do: [a, b, c], else: [b, a, c] end)
  end

  defp triangle_fan([a | others]),
    do: Enum.zip_with(others, Enum.drop(others, 1), fn b, c -> [a, b, c] end)

  defp triangle_fan([]), do: []

  defp read_indices(%{"componentType" => type, "type" => "SCALAR"} = accessor, scene, body)
       when is_map_key(@numbers, type) do
    bits = 8 * @numbers[type]

    for <<i::little-pinned_size(bits) <- read_elements(accessor, @numbers[type], scene, body)>>,
      do: i
  end

  defp read_indices(_accessor, _scene, _body),
    do: reject_file!("the indices of triangles have an unsupported type")

  # Returns the bytes of an accessor, with its elements packed tightly.
  defp read_elements(%{"bufferView" => number, "count" => count} = accessor, size, scene, body)
       when not is_map_key(accessor, "sparse") and is_integer(count) and count in 0..@most do
    view = fetch_item!(scene, "bufferViews", number)
    stride = view["byteStride"] || size
    from = byte_offset(view) + byte_offset(accessor)
    bytes = buffer_bytes(fetch_item!(scene, "buffers", view["buffer"]), view["buffer"], body)

    cond do
      count == 0 ->
        ""

      not is_integer(stride) or stride < size ->
        reject_file!("elements overlap")

      from + (count - 1) * stride + size > byte_size(bytes) ->
        reject_file!("its buffer ends too early")

      stride == size ->
        binary_part(bytes, from, count * size)

      true ->
        for i <- 0..(count - 1), into: <<>>, do: binary_part(bytes, from + i * stride, size)
    end
  end

  defp read_elements(_accessor, _size, _scene, _body),
    do: reject_file!("an accessor is sparse or has no buffer")

  defp byte_offset(%{"byteOffset" => offset}) when is_integer(offset) and offset >= 0, do: offset
  defp byte_offset(%{"byteOffset" => _}), do: reject_file!("an offset is not a valid number")
  defp byte_offset(_none), do: 0

  # Loads the bytes of each buffer once.
  defp load_buffers(scene, folder),
    do:
      Map.put(scene, "buffers", Enum.map(ensure_maps(scene["buffers"]), &load_buffer(&1, folder)))

  defp load_buffer(%{"uri" => "data:" <> data} = buffer, _folder) do
    with [_, text] <- String.split(data, ";base64,", parts: 2),
         {:ok, bytes} <- Base.decode64(text) do
      Map.put(buffer, "bytes", bytes)
    else
      _ -> reject_file!("its embedded bytes are not valid base64")
    end
  end

  defp load_buffer(%{"uri" => uri} = buffer, folder) when is_binary(uri) do
    name = URI.decode(uri)

    # The file is untrusted, so it may only refer to files in its own folder.
    if folder == nil or name == "" or Path.type(name) != :relative or name =~ ~r/[\x00:\\]/ or
         ".." in Path.split(name),
       do: reject_file!("its buffer refers to a file outside its own folder; save it as .glb")

    path = Path.join(folder, name)

    with {:ok, %{type: :regular, size: size}} when size <= @most_bytes <- File.stat(path),
         {:ok, bytes} <- File.read(path) do
      Map.put(buffer, "bytes", bytes)
    else
      _ -> reject_file!("the buffer file #{String.slice(name, 0, 100)} does not exist")
    end
  rescue
    ArgumentError -> reject_file!("the name of a buffer file is invalid")
  end

  defp load_buffer(%{"uri" => _}, _folder),
    do: reject_file!("the name of a buffer file is invalid")

  defp load_buffer(buffer, _folder), do: Map.delete(buffer, "bytes")

  defp buffer_bytes(%{"bytes" => bytes}, _number, _body), do: bytes
  defp buffer_bytes(_own, 0, body) when is_binary(body), do: body
  defp buffer_bytes(_own, _number, _body), do: reject_file!("a buffer has no bytes")
end

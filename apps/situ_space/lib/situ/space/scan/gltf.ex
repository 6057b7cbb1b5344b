defmodule Situ.Space.Scan.Gltf do
  @moduledoc false
  # Parses glTF 2.0 by Khronos: `.glb`, or `.gltf` with its bytes embedded or in files in the same folder. Reads every
  # triangle of the scene, transformed by its node, without materials, skins and animations. Its axes (y up, z forward)
  # are converted to ours (x forward, z up).
  import Situ.Bits, only: [known: 1]
  import Bitwise
  alias Situ.{Error, JSON, Mesh}

  @identity {1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0}
  @most 50_000_000
  @numbers %{5121 => 1, 5123 => 2, 5125 => 4}

  # Required extensions that do not change positions, so that they can be ignored.
  @harmless ~r/\A(KHR_materials_|KHR_texture_|EXT_texture_|KHR_lights_|KHR_xmp|KHR_animation_)/
  @most_bytes 2_000_000_000

  @doc "Returns the mesh of the complete scene. `folder` contains the files that it refers to; `nil` allows no files."
  @spec read(binary(), Path.t() | nil) :: {:ok, Mesh.t()} | {:error, Error.t()}
  def read(bytes, folder \\ nil) do
    {json, body} = chunks(bytes)

    case JSON.decode(json) do
      {:ok, %{"asset" => %{"version" => "2." <> _}} = scene} ->
        scene |> supported() |> fetched(folder) |> mesh(body)

      {:ok, _} ->
        bad("it is not glTF version 2")

      {:error, _} ->
        bad("its description is not valid JSON")
    end
  catch
    {:bad, why} -> bad(why)
  end

  defp bad(why),
    do: {:error, Error.new(:bad_file, "invalid glTF file", why: why)}

  defp no!(why), do: throw({:bad, why})

  defp chunks(
         <<"glTF", 2::little-32, _::32, n::little-32, "JSON", json::binary-size(n), rest::binary>>
       ) do
    case rest do
      <<n::little-32, "BIN", 0, body::binary-size(n), _::binary>> -> {json, body}
      _ -> {json, nil}
    end
  end

  defp chunks(<<"glTF", _::binary>>), do: no!("its first chunk is cut off or has another version")
  defp chunks(text), do: {text, nil}

  defp supported(scene) do
    needs = scene["extensionsRequired"] || []
    if not is_list(needs), do: no!("extensionsRequired is not a list")

    case Enum.reject(needs, &(is_binary(&1) and &1 =~ @harmless)) do
      [] ->
        scene

      needs ->
        no!(
          "it requires #{inspect(needs, limit: 5, printable_limit: 200)}; save it without compression"
        )
    end
  end

  defp mesh(scene, body) do
    shapes = scene |> roots() |> nodes(scene, @identity, MapSet.new()) |> elem(0)

    parts =
      for {number, matrix} <- shapes,
          part <- maps(item(scene, "meshes", number)["primitives"]),
          do: {part, matrix}

    {vertices, indices, _} =
      Enum.reduce(parts, {[], [], 0}, fn {part, matrix}, {vertices, indices, first} ->
        places = places(part, scene, body)
        count = div(byte_size(places), 12)
        if first + count > @most, do: no!("it has more than #{@most} vertices")

        {[vertices, moved(places, matrix)], [indices, triangles(part, count, first, scene, body)],
         first + count}
      end)

    vertices = IO.iodata_to_binary(vertices)

    if vertices == "",
      do: no!("its scene has no surface"),
      else: Mesh.new(vertices, IO.iodata_to_binary(indices))
  end

  defp roots(scene) do
    case scene["scenes"] do
      list when is_list(list) and list != [] ->
        item(scene, "scenes", scene["scene"] || 0)["nodes"] || []

      _ ->
        Enum.to_list(0..(length(maps(scene["nodes"])) - 1)//1)
    end
  end

  defp maps(nil), do: []

  defp maps(list) do
    if is_list(list) and Enum.all?(list, &is_map/1),
      do: list,
      else: no!("a list of its scene is not a list of objects")
  end

  # Collects every mesh with its matrix. A node that occurs twice has two parents or is its own descendant.
  defp nodes(numbers, scene, outer, seen) when is_list(numbers) do
    Enum.reduce(numbers, {[], seen}, fn number, {shapes, seen} ->
      if number in seen, do: no!("node #{inspect(number)} occurs twice in the scene")
      node = item(scene, "nodes", number)
      matrix = multiply(outer, local(node))
      own = if node["mesh"], do: [{node["mesh"], matrix}], else: []
      {inner, seen} = nodes(node["children"] || [], scene, matrix, MapSet.put(seen, number))
      {shapes ++ own ++ inner, seen}
    end)
  end

  defp nodes(_other, _scene, _outer, _seen), do: no!("a node's children are not a list")

  defp item(scene, kind, number) when is_integer(number) and number >= 0 do
    case scene[kind] do
      list when is_list(list) -> Enum.at(list, number)
      _ -> nil
    end
    |> case do
      %{} = item -> item
      _ -> no!("item #{number} of its #{kind} does not exist")
    end
  end

  defp item(_scene, kind, number), do: no!("#{inspect(number)} is not an index of its #{kind}")

  # glTF stores three columns and the translation.
  defp local(%{"matrix" => list}) do
    case floats(list, 16) do
      [a, b, c, _, d, e, f, _, g, h, i, _, x, y, z, _] -> {a, b, c, d, e, f, g, h, i, x, y, z}
    end
  end

  defp local(node) do
    [x, y, z] = floats(node["translation"] || [0, 0, 0], 3)
    [i, j, k, w] = floats(node["rotation"] || [0, 0, 0, 1], 4)
    [sx, sy, sz] = floats(node["scale"] || [1, 1, 1], 3)

    {sx * (1 - 2 * (j * j + k * k)), sx * 2 * (i * j + k * w), sx * 2 * (i * k - j * w),
     sy * 2 * (i * j - k * w), sy * (1 - 2 * (i * i + k * k)), sy * 2 * (j * k + i * w),
     sz * 2 * (i * k + j * w), sz * 2 * (j * k - i * w), sz * (1 - 2 * (i * i + j * j)), x, y, z}
  end

  defp floats(list, count) do
    if is_list(list) and length(list) == count and
         Enum.all?(list, &(is_number(&1) and abs(&1) < 1.0e9)),
       do: Enum.map(list, &(&1 * 1.0)),
       else: no!("a node's transform must have #{count} numbers")
  end

  defp multiply(m, {a, b, c, d, e, f, g, h, i, x, y, z}) do
    {a, b, c} = turn(m, a, b, c)
    {d, e, f} = turn(m, d, e, f)
    {g, h, i} = turn(m, g, h, i)
    {dx, dy, dz} = turn(m, x, y, z)

    {a, b, c, d, e, f, g, h, i, in_range(dx + elem(m, 9)), in_range(dy + elem(m, 10)),
     in_range(dz + elem(m, 11))}
  end

  defp turn({a, b, c, d, e, f, g, h, i, _, _, _}, x, y, z),
    do:
      {in_range(a * x + d * y + g * z), in_range(b * x + e * y + h * z),
       in_range(c * x + f * y + i * z)}

  # A deep tree of large factors would overflow.
  defp in_range(x) when abs(x) < 1.0e20, do: x
  defp in_range(_x), do: no!("a node's transform is out of range")

  defp places(part, scene, body) do
    with %{"attributes" => %{"POSITION" => number}} <- part,
         %{"componentType" => 5126, "type" => "VEC3"} = accessor <-
           item(scene, "accessors", number) do
      elements(accessor, 12, scene, body)
    else
      _ -> no!("a surface has no positions in 32-bit floats")
    end
  end

  defp moved(places, {a, b, c, d, e, f, g, h, i, x, y, z}) do
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
      else: no!("a vertex has coordinates that are not finite")
  end

  defp triangles(part, count, first, scene, body) do
    numbers =
      if part["indices"],
        do: indices(item(scene, "accessors", part["indices"]), scene, body),
        else: Enum.to_list(0..(count - 1)//1)

    if Enum.any?(numbers, &(&1 >= count)),
      do: no!("a triangle refers to a vertex that does not exist")

    case part["mode"] || 4 do
      4 -> Enum.chunk_every(numbers, 3, 3, :discard)
      5 -> strip(numbers)
      6 -> fan(numbers)
      _points_or_lines -> []
    end
    |> Enum.map(fn [a, b, c] ->
      <<a + first::little-32, b + first::little-32, c + first::little-32>>
    end)
  end

  defp strip(numbers) do
    numbers
    |> Enum.chunk_every(3, 1, :discard)
    |> Enum.with_index(fn [a, b, c], i -> if (i &&& 1) == 0, do: [a, b, c], else: [b, a, c] end)
  end

  defp fan([a | others]),
    do: Enum.zip_with(others, Enum.drop(others, 1), fn b, c -> [a, b, c] end)

  defp fan([]), do: []

  defp indices(%{"componentType" => type, "type" => "SCALAR"} = accessor, scene, body)
       when is_map_key(@numbers, type) do
    bits = 8 * @numbers[type]
    for <<i::little-known(bits) <- elements(accessor, @numbers[type], scene, body)>>, do: i
  end

  defp indices(_accessor, _scene, _body),
    do: no!("the indices of triangles have an unsupported type")

  # Returns the bytes of an accessor, with its elements packed tightly.
  defp elements(%{"bufferView" => number, "count" => count} = accessor, size, scene, body)
       when not is_map_key(accessor, "sparse") and is_integer(count) and count in 0..@most do
    view = item(scene, "bufferViews", number)
    stride = view["byteStride"] || size
    from = offset(view) + offset(accessor)
    bytes = buffer(item(scene, "buffers", view["buffer"]), view["buffer"], body)

    cond do
      count == 0 -> ""
      not is_integer(stride) or stride < size -> no!("elements overlap")
      from + (count - 1) * stride + size > byte_size(bytes) -> no!("its buffer ends too early")
      stride == size -> binary_part(bytes, from, count * size)
      true -> for i <- 0..(count - 1), into: <<>>, do: binary_part(bytes, from + i * stride, size)
    end
  end

  defp elements(_accessor, _size, _scene, _body),
    do: no!("an accessor is sparse or has no buffer")

  defp offset(%{"byteOffset" => offset}) when is_integer(offset) and offset >= 0, do: offset
  defp offset(%{"byteOffset" => _}), do: no!("an offset is not a valid number")
  defp offset(_none), do: 0

  # Loads the bytes of each buffer once.
  defp fetched(scene, folder),
    do: Map.put(scene, "buffers", Enum.map(maps(scene["buffers"]), &fetch(&1, folder)))

  defp fetch(%{"uri" => "data:" <> data} = buffer, _folder) do
    with [_, text] <- String.split(data, ";base64,", parts: 2),
         {:ok, bytes} <- Base.decode64(text) do
      Map.put(buffer, "bytes", bytes)
    else
      _ -> no!("its embedded bytes are not valid base64")
    end
  end

  defp fetch(%{"uri" => uri} = buffer, folder) when is_binary(uri) do
    name = URI.decode(uri)

    # The file is untrusted, so it may only refer to files in its own folder.
    if folder == nil or name == "" or Path.type(name) != :relative or name =~ ~r/[\x00:\\]/ or
         ".." in Path.split(name),
       do: no!("its buffer refers to a file outside its own folder; save it as .glb")

    path = Path.join(folder, name)

    with {:ok, %{type: :regular, size: size}} when size <= @most_bytes <- File.stat(path),
         {:ok, bytes} <- File.read(path) do
      Map.put(buffer, "bytes", bytes)
    else
      _ -> no!("the buffer file #{String.slice(name, 0, 100)} does not exist")
    end
  rescue
    ArgumentError -> no!("the name of a buffer file is invalid")
  end

  defp fetch(%{"uri" => _}, _folder), do: no!("the name of a buffer file is invalid")
  defp fetch(buffer, _folder), do: Map.delete(buffer, "bytes")

  defp buffer(%{"bytes" => bytes}, _number, _body), do: bytes
  defp buffer(_own, 0, body) when is_binary(body), do: body
  defp buffer(_own, _number, _body), do: no!("a buffer has no bytes")
end

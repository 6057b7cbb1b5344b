defmodule Situ.Space.GeometryFile.Ply do
  @moduledoc false
  # Parses PLY, as text or binary: vertices with x, y, z and optionally red, green, blue, intensity; faces as lists of
  # vertices. Source: G. Turk, The PLY Polygon File Format, 1994.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.{Error, Mesh, PointCloud}
  alias Situ.Space.NativeCall
  alias Situ.Space.GeometryFile.NumberParser

  @types %{
    "char" => {:int, 1},
    "int8" => {:int, 1},
    "uchar" => {:uint, 1},
    "uint8" => {:uint, 1},
    "short" => {:int, 2},
    "int16" => {:int, 2},
    "ushort" => {:uint, 2},
    "uint16" => {:uint, 2},
    "int" => {:int, 4},
    "int32" => {:int, 4},
    "uint" => {:uint, 4},
    "uint32" => {:uint, 4},
    "float" => {:float, 4},
    "float32" => {:float, 4},
    "double" => {:float, 8},
    "float64" => {:float, 8}
  }
  @most 100_000_000

  @doc "Returns a mesh if there are faces, or else a point cloud."
  @spec parse_file(binary()) :: {:ok, Mesh.t() | PointCloud.t()} | {:error, Error.t()}
  def parse_file(<<"ply", _::binary>> = file) do
    with [head, body] <- String.split(file, ~r/end_header\r?\n/, parts: 2),
         {:ok, format, elements} <- parse_header(String.split(head, ~r/\r?\n/, trim: true)),
         {:ok, rows} <- parse_body(format, elements, body) do
      build_shape(rows, elements)
    else
      [_] -> file_error("its header has no end")
      {:error, %Error{}} = error -> error
      {:error, why} -> file_error(why)
    end
  end

  def parse_file(_file), do: file_error("it does not begin with \"ply\"")

  defp parse_header(["ply" | lines]),
    do: Enum.reduce_while(lines, {:ok, nil, []}, &parse_line/2) |> restore_order()

  defp parse_header(_lines), do: {:error, "its first line is not \"ply\""}

  defp restore_order({:ok, nil, _}), do: {:error, "its header has no format"}

  defp restore_order({:ok, format, elements}),
    do: {:ok, format, for({n, c, p} <- Enum.reverse(elements), do: {n, c, Enum.reverse(p)})}

  defp restore_order(error), do: error

  defp parse_line(line, {:ok, format, elements}) do
    case {String.split(line), elements} do
      {["format", "ascii", _], _} ->
        {:cont, {:ok, :ascii, elements}}

      {["format", "binary_little_endian", _], _} ->
        {:cont, {:ok, :little, elements}}

      {["format", "binary_big_endian", _], _} ->
        {:cont, {:ok, :big, elements}}

      {["format", other | _], _} ->
        {:halt, {:error, "its format #{other} is unknown"}}

      {["element", name, count], _} ->
        add_element(name, Integer.parse(count), format, elements)

      {["property", "list", size, type, name], [{n, c, p} | rest]} ->
        add_property({:list, @types[size], @types[type]}, name, format, {n, c, p}, rest)

      {["property", type, name], [{n, c, p} | rest]} ->
        add_property(@types[type], name, format, {n, c, p}, rest)

      {[word | _], _} when word in ["comment", "obj_info"] ->
        {:cont, {:ok, format, elements}}

      _ ->
        {:halt, {:error, "its header has the invalid line #{inspect(String.slice(line, 0, 60))}"}}
    end
  end

  defp add_element(name, {count, ""}, format, elements) when count in 0..@most,
    do: {:cont, {:ok, format, [{name, count, []} | elements]}}

  defp add_element(name, _count, _format, _elements),
    do: {:halt, {:error, "its number of #{name} elements is invalid"}}

  defp add_property(type, name, format, {n, c, p}, rest) do
    if type == nil or match?({:list, a, b} when a == nil or b == nil, type),
      do: {:halt, {:error, "the type of its property #{name} is unknown"}},
      else: {:cont, {:ok, format, [{n, c, [{name, type} | p]} | rest]}}
  end

  # Returns the rows of each element, as lists of values in the order of its properties.
  defp parse_body(:ascii, elements, text) do
    lines = text |> String.split(~r/\r?\n/, trim: true) |> Enum.map(&String.split/1)

    elements
    |> Enum.reduce_while({:ok, %{}, lines}, fn {name, count, properties}, {:ok, rows, lines} ->
      {own, rest} = Enum.split(lines, count)

      if length(own) == count,
        do:
          {:cont, {:ok, Map.put(rows, name, Enum.map(own, &parse_words(&1, properties))), rest}},
        else: {:halt, {:error, "it is cut short"}}
    end)
    |> drop_rest()
  catch
    :no_number -> {:error, "a line has missing or invalid numbers"}
  end

  # The native kernel reads records of fixed size, because there may be millions of them.
  defp parse_body(order, [{"vertex", count, [_ | _] = properties} | elements], bytes) do
    if Enum.any?(properties, &match?({_, {:list, _, _}}, &1)) do
      read_binary_rows(order, [{"vertex", count, properties} | elements], bytes)
    else
      size = properties |> Enum.map(fn {_, {_, size}} -> size end) |> Enum.sum()

      case bytes do
        <<own::binary-pinned_size(count * size), rest::binary>> ->
          with {:ok, rows} <- read_binary_rows(order, elements, rest),
               do: {:ok, Map.put(rows, "vertex", {:packed, own, size, order == :big})}

        _ ->
          {:error, "it is cut short"}
      end
    end
  end

  defp parse_body(order, elements, bytes), do: read_binary_rows(order, elements, bytes)

  defp read_binary_rows(order, elements, bytes) do
    elements
    |> Enum.reduce({:ok, %{}, bytes}, fn {name, count, properties}, {:ok, rows, bytes} ->
      # Every row has at least one byte, so the remaining bytes bound the number of rows that the header states.
      if count > byte_size(bytes), do: throw(:short)
      {own, rest} = repeat_read(count, bytes, &read_values(properties, &1, order, []))
      {:ok, Map.put(rows, name, own), rest}
    end)
    |> drop_rest()
  catch
    :short -> {:error, "it is cut short"}
  end

  defp repeat_read(count, bytes, fun),
    do: Enum.map_reduce(List.duplicate(nil, count), bytes, fn _, bytes -> fun.(bytes) end)

  defp drop_rest({:ok, rows, _rest}), do: {:ok, rows}
  defp drop_rest(error), do: error

  defp parse_words([], []), do: []

  defp parse_words([n | words], [{_, {:list, _, _}} | properties]) do
    {own, rest} = Enum.split(words, parse_count(n))
    [Enum.map(own, &parse_number/1) | parse_words(rest, properties)]
  end

  # Float properties stay floats, because a float colour of 1 means 255.
  defp parse_words([word | words], [{_, {:float, _}} | properties]),
    do: [float_number(word) | parse_words(words, properties)]

  defp parse_words([word | words], [_ | properties]),
    do: [parse_number(word) | parse_words(words, properties)]

  defp parse_words(_words, []), do: []
  defp parse_words([], _properties), do: throw(:no_number)

  defp parse_number(word) do
    case Integer.parse(word) do
      {n, ""} -> n
      _ -> float_number(word)
    end
  end

  defp float_number(word),
    do:
      with(
        {:ok, x} <- NumberParser.parse_number(word),
        do: x,
        else: (:error -> throw(:no_number))
      )

  defp parse_count(word) do
    case Integer.parse(word) do
      {n, ""} when n >= 0 -> n
      _ -> throw(:no_number)
    end
  end

  defp read_values([], bytes, _order, row), do: {Enum.reverse(row), bytes}

  defp read_values([{_, {:list, size, type}} | rest], bytes, order, row) do
    {count, bytes} = read_value(size, bytes, order)
    if not is_integer(count) or count < 0 or count > byte_size(bytes), do: throw(:short)

    {list, bytes} = repeat_read(count, bytes, &read_value(type, &1, order))

    read_values(rest, bytes, order, [list | row])
  end

  defp read_values([{_, type} | rest], bytes, order, row) do
    {value, bytes} = read_value(type, bytes, order)
    read_values(rest, bytes, order, [value | row])
  end

  defp read_value({kind, size}, bytes, order) do
    case bytes do
      <<own::binary-pinned_size(size), rest::binary>> ->
        {decode_number(kind, 8 * size, own, order), rest}

      _ ->
        throw(:short)
    end
  end

  defp decode_number(:float, bits, bytes, order) do
    case {order, bytes} do
      {:little, <<x::little-float-pinned_size(bits)>>} -> x
      {:big, <<x::float-pinned_size(bits)>>} -> x
      _ -> :nan
    end
  end

  defp decode_number(:int, bits, bytes, :little),
    do: with(<<x::little-signed-pinned_size(bits)>> <- bytes, do: x)

  defp decode_number(:int, bits, bytes, :big),
    do: with(<<x::signed-pinned_size(bits)>> <- bytes, do: x)

  defp decode_number(:uint, bits, bytes, :little),
    do: with(<<x::little-pinned_size(bits)>> <- bytes, do: x)

  defp decode_number(:uint, bits, bytes, :big), do: with(<<x::pinned_size(bits)>> <- bytes, do: x)

  defp build_shape(rows, elements) do
    {_, _, properties} = List.keyfind(elements, "vertex", 0) || {nil, 0, []}
    names = Enum.map(properties, &elem(&1, 0))
    places = for name <- ["x", "y", "z"], do: Enum.find_index(names, &(&1 == name))
    tones = for name <- ["red", "green", "blue"], do: Enum.find_index(names, &(&1 == name))

    value =
      Enum.find_index(
        names,
        &(&1 in ["intensity", "scalar_intensity", "scalar_Intensity", "quality"])
      )

    vertices = rows["vertex"] || []

    columns = &field_layout(properties, &1)

    cond do
      nil in places ->
        file_error("its vertices have no x, y and z")

      faces = find_faces(rows, elements) ->
        points = encode_points(vertices, columns.(places))
        build_mesh(points, faces, div(byte_size(points), 12))

      true ->
        PointCloud.new(
          encode_points(vertices, columns.(places)),
          if(nil not in tones, do: encode_colors(vertices, columns.(tones))),
          value && encode_points(vertices, columns.([value]))
        )
    end
  end

  # Returns the index, byte offset and type of each of these vertex properties.
  defp field_layout(properties, places) do
    for place <- places do
      before = for {_, {_, size}} <- Enum.take(properties, place), is_integer(size), do: size
      {place, Enum.sum(before), properties |> Enum.at(place) |> elem(1)}
    end
  end

  defp encode_points({:packed, bytes, row, big?}, fields) do
    fields = for {_, at, type} <- fields, do: {at, type}
    Error.unwrap!(NativeCall.call_native(:record_floats, [bytes, row, fields, big?]))
  end

  defp encode_points(vertices, fields) do
    for row <- vertices,
        {place, _, _} <- fields,
        into: <<>>,
        do: encode_float(Enum.at(row, place))
  end

  defp encode_float(x) when is_number(x) and abs(x) < 3.4e38, do: <<x::little-float-32>>
  defp encode_float(_), do: <<0, 0, 0xC0, 0x7F>>

  defp encode_colors({:packed, bytes, row, big?}, fields) do
    fields = for {_, at, type} <- fields, do: {at, type}
    Error.unwrap!(NativeCall.call_native(:record_tones, [bytes, row, fields, big?]))
  end

  defp encode_colors(vertices, fields) do
    for row <- vertices,
        {place, _, _} <- fields,
        into: <<>>,
        do: <<color_byte(Enum.at(row, place))>>
  end

  defp color_byte(x) when is_integer(x), do: x |> max(0) |> min(255)
  defp color_byte(x) when is_float(x), do: round(255 * (x |> max(0.0) |> min(1.0)))
  defp color_byte(:infinity), do: 255
  defp color_byte(_), do: 0

  defp find_faces(rows, elements) do
    with {_, _, properties} <- List.keyfind(elements, "face", 0),
         at when at != nil <-
           Enum.find_index(properties, &(elem(&1, 0) in ["vertex_indices", "vertex_index"])),
         [_ | _] = faces <- rows["face"],
         do: Enum.map(faces, &Enum.at(&1, at)),
         else: (_ -> nil)
  end

  # Polygons are split into fans of triangles.
  defp build_mesh(vertices, faces, count) do
    triangles =
      for [a | others] when length(others) >= 2 <- faces,
          {b, c} <- Enum.zip(others, tl(others)),
          do: [a, b, c]

    if Enum.all?(triangles, fn t ->
         Enum.all?(t, &(is_integer(&1) and &1 in 0..(count - 1)//1))
       end),
       do:
         Mesh.new(vertices, for(i <- List.flatten(triangles), into: <<>>, do: <<i::little-32>>)),
       else: file_error("a face refers to a vertex that does not exist")
  end

  defp file_error(why),
    do: {:error, Error.new(:bad_file, "invalid PLY file", why: why)}
end

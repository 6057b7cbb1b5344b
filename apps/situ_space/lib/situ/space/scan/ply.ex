defmodule Situ.Space.Scan.Ply do
  @moduledoc false
  # Parses PLY, as text or binary: vertices with x, y, z and optionally red, green, blue, intensity; faces as lists of
  # vertices. Source: G. Turk, The PLY Polygon File Format, 1994.
  import Situ.Bits, only: [known: 1]
  alias Situ.{Error, Mesh, PointCloud}
  alias Situ.Space.Kernel
  alias Situ.Space.Scan.Text

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

  @doc "Returns a mesh if there are faces, otherwise a point cloud."
  @spec read(binary()) :: {:ok, Mesh.t() | PointCloud.t()} | {:error, Error.t()}
  def read(<<"ply", _::binary>> = file) do
    with [head, body] <- String.split(file, ~r/end_header\r?\n/, parts: 2),
         {:ok, format, elements} <- header(String.split(head, ~r/\r?\n/, trim: true)),
         {:ok, rows} <- body(format, elements, body) do
      shape(rows, elements)
    else
      [_] -> bad("its header has no end")
      {:error, %Error{}} = error -> error
      {:error, why} -> bad(why)
    end
  end

  def read(_file), do: bad("it does not begin with \"ply\"")

  defp header(["ply" | lines]), do: Enum.reduce_while(lines, {:ok, nil, []}, &line/2) |> ordered()

  defp header(_lines), do: {:error, "its first line is not \"ply\""}

  defp ordered({:ok, nil, _}), do: {:error, "its header has no format"}

  defp ordered({:ok, format, elements}),
    do: {:ok, format, for({n, c, p} <- Enum.reverse(elements), do: {n, c, Enum.reverse(p)})}

  defp ordered(error), do: error

  defp line(line, {:ok, format, elements}) do
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
        element(name, Integer.parse(count), format, elements)

      {["property", "list", size, type, name], [{n, c, p} | rest]} ->
        property({:list, @types[size], @types[type]}, name, format, {n, c, p}, rest)

      {["property", type, name], [{n, c, p} | rest]} ->
        property(@types[type], name, format, {n, c, p}, rest)

      {[word | _], _} when word in ["comment", "obj_info"] ->
        {:cont, {:ok, format, elements}}

      _ ->
        {:halt, {:error, "its header has the invalid line #{inspect(String.slice(line, 0, 60))}"}}
    end
  end

  defp element(name, {count, ""}, format, elements) when count in 0..@most,
    do: {:cont, {:ok, format, [{name, count, []} | elements]}}

  defp element(name, _count, _format, _elements),
    do: {:halt, {:error, "its number of #{name} elements is invalid"}}

  defp property(type, name, format, {n, c, p}, rest) do
    if type == nil or match?({:list, a, b} when a == nil or b == nil, type),
      do: {:halt, {:error, "the type of its property #{name} is unknown"}},
      else: {:cont, {:ok, format, [{n, c, [{name, type} | p]} | rest]}}
  end

  # Returns the rows of each element, as lists of values in the order of its properties.
  defp body(:ascii, elements, text) do
    lines = text |> String.split(~r/\r?\n/, trim: true) |> Enum.map(&String.split/1)

    elements
    |> Enum.reduce_while({:ok, %{}, lines}, fn {name, count, properties}, {:ok, rows, lines} ->
      {own, rest} = Enum.split(lines, count)

      if length(own) == count,
        do: {:cont, {:ok, Map.put(rows, name, Enum.map(own, &words(&1, properties))), rest}},
        else: {:halt, {:error, "it is cut short"}}
    end)
    |> rows()
  catch
    :no_number -> {:error, "a line has missing or invalid numbers"}
  end

  # The native kernel reads records of fixed size, because there may be millions of them.
  defp body(order, [{"vertex", count, [_ | _] = properties} | elements], bytes) do
    if Enum.any?(properties, &match?({_, {:list, _, _}}, &1)) do
      each(order, [{"vertex", count, properties} | elements], bytes)
    else
      size = properties |> Enum.map(fn {_, {_, size}} -> size end) |> Enum.sum()

      case bytes do
        <<own::binary-known(count * size), rest::binary>> ->
          with {:ok, rows} <- each(order, elements, rest),
               do: {:ok, Map.put(rows, "vertex", {:packed, own, size, order == :big})}

        _ ->
          {:error, "it is cut short"}
      end
    end
  end

  defp body(order, elements, bytes), do: each(order, elements, bytes)

  defp each(order, elements, bytes) do
    elements
    |> Enum.reduce({:ok, %{}, bytes}, fn {name, count, properties}, {:ok, rows, bytes} ->
      # Every row has at least one byte, so the remaining bytes bound the number of rows that the header states.
      if count > byte_size(bytes), do: throw(:short)
      {own, rest} = repeat(count, bytes, &values(properties, &1, order, []))
      {:ok, Map.put(rows, name, own), rest}
    end)
    |> rows()
  catch
    :short -> {:error, "it is cut short"}
  end

  defp repeat(count, bytes, fun),
    do: Enum.map_reduce(List.duplicate(nil, count), bytes, fn _, bytes -> fun.(bytes) end)

  defp rows({:ok, rows, _rest}), do: {:ok, rows}
  defp rows(error), do: error

  defp words([], []), do: []

  defp words([n | words], [{_, {:list, _, _}} | properties]) do
    {own, rest} = Enum.split(words, count(n))
    [Enum.map(own, &number/1) | words(rest, properties)]
  end

  # Float properties stay floats, because a float colour of 1 means 255.
  defp words([word | words], [{_, {:float, _}} | properties]),
    do: [float_number(word) | words(words, properties)]

  defp words([word | words], [_ | properties]), do: [number(word) | words(words, properties)]
  defp words(_words, []), do: []
  defp words([], _properties), do: throw(:no_number)

  defp number(word) do
    case Integer.parse(word) do
      {n, ""} -> n
      _ -> float_number(word)
    end
  end

  defp float_number(word),
    do: with({:ok, x} <- Text.parse_number(word), do: x, else: (:error -> throw(:no_number)))

  defp count(word) do
    case Integer.parse(word) do
      {n, ""} when n >= 0 -> n
      _ -> throw(:no_number)
    end
  end

  defp values([], bytes, _order, row), do: {Enum.reverse(row), bytes}

  defp values([{_, {:list, size, type}} | rest], bytes, order, row) do
    {count, bytes} = value(size, bytes, order)
    if not is_integer(count) or count < 0 or count > byte_size(bytes), do: throw(:short)

    {list, bytes} = repeat(count, bytes, &value(type, &1, order))

    values(rest, bytes, order, [list | row])
  end

  defp values([{_, type} | rest], bytes, order, row) do
    {value, bytes} = value(type, bytes, order)
    values(rest, bytes, order, [value | row])
  end

  defp value({kind, size}, bytes, order) do
    case bytes do
      <<own::binary-known(size), rest::binary>> -> {number(kind, 8 * size, own, order), rest}
      _ -> throw(:short)
    end
  end

  defp number(:float, bits, bytes, order) do
    case {order, bytes} do
      {:little, <<x::little-float-known(bits)>>} -> x
      {:big, <<x::float-known(bits)>>} -> x
      _ -> :nan
    end
  end

  defp number(:int, bits, bytes, :little),
    do: with(<<x::little-signed-known(bits)>> <- bytes, do: x)

  defp number(:int, bits, bytes, :big), do: with(<<x::signed-known(bits)>> <- bytes, do: x)
  defp number(:uint, bits, bytes, :little), do: with(<<x::little-known(bits)>> <- bytes, do: x)
  defp number(:uint, bits, bytes, :big), do: with(<<x::known(bits)>> <- bytes, do: x)

  defp shape(rows, elements) do
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

    columns = &fields(properties, &1)

    cond do
      nil in places ->
        bad("its vertices have no x, y and z")

      faces = faces(rows, elements) ->
        points = points(vertices, columns.(places))
        mesh(points, faces, div(byte_size(points), 12))

      true ->
        PointCloud.new(
          points(vertices, columns.(places)),
          if(nil not in tones, do: colors(vertices, columns.(tones))),
          value && points(vertices, columns.([value]))
        )
    end
  end

  # Returns the index, byte offset and type of each of these vertex properties.
  defp fields(properties, places) do
    for place <- places do
      before = for {_, {_, size}} <- Enum.take(properties, place), is_integer(size), do: size
      {place, Enum.sum(before), properties |> Enum.at(place) |> elem(1)}
    end
  end

  defp points({:packed, bytes, row, big?}, fields) do
    fields = for {_, at, type} <- fields, do: {at, type}
    Error.unwrap!(Kernel.call(:record_floats, [bytes, row, fields, big?]))
  end

  defp points(vertices, fields) do
    for row <- vertices, {place, _, _} <- fields, into: <<>>, do: float(Enum.at(row, place))
  end

  defp float(x) when is_number(x) and abs(x) < 3.4e38, do: <<x::little-float-32>>
  defp float(_), do: <<0, 0, 0xC0, 0x7F>>

  defp colors({:packed, bytes, row, big?}, fields) do
    fields = for {_, at, type} <- fields, do: {at, type}
    Error.unwrap!(Kernel.call(:record_tones, [bytes, row, fields, big?]))
  end

  defp colors(vertices, fields) do
    for row <- vertices, {place, _, _} <- fields, into: <<>>, do: <<tone(Enum.at(row, place))>>
  end

  defp tone(x) when is_integer(x), do: x |> max(0) |> min(255)
  defp tone(x) when is_float(x), do: round(255 * (x |> max(0.0) |> min(1.0)))
  defp tone(:infinity), do: 255
  defp tone(_), do: 0

  defp faces(rows, elements) do
    with {_, _, properties} <- List.keyfind(elements, "face", 0),
         at when at != nil <-
           Enum.find_index(properties, &(elem(&1, 0) in ["vertex_indices", "vertex_index"])),
         [_ | _] = faces <- rows["face"],
         do: Enum.map(faces, &Enum.at(&1, at)),
         else: (_ -> nil)
  end

  # Polygons are split into fans of triangles.
  defp mesh(vertices, faces, count) do
    triangles =
      for [a | others] when length(others) >= 2 <- faces,
          {b, c} <- Enum.zip(others, tl(others)),
          do: [a, b, c]

    if Enum.all?(triangles, fn t ->
         Enum.all?(t, &(is_integer(&1) and &1 in 0..(count - 1)//1))
       end),
       do:
         Mesh.new(vertices, for(i <- List.flatten(triangles), into: <<>>, do: <<i::little-32>>)),
       else: bad("a face refers to a vertex that does not exist")
  end

  defp bad(why),
    do: {:error, Error.new(:bad_file, "invalid PLY file", why: why)}
end

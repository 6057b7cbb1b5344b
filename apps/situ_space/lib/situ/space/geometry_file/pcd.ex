defmodule Situ.Space.GeometryFile.Pcd do
  @moduledoc false
  # Parses PCD, the format of the Point Cloud Library: a text header, then the points as text, as binary records, or as
  # LZF-compressed columns. Source: pointclouds.org, "The PCD (Point Cloud Data) file format", version 0.7.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.{Error, PointCloud}
  alias Situ.Space.NativeCall
  alias Situ.Space.GeometryFile.NumberParser

  @most_points 50_000_000
  @nan <<0, 0, 0xC0, 0x7F>>

  @doc "Returns the points (x, y and z) with colours from the fields `rgb` or `rgba`, and values from `intensity`."
  @spec parse_file(binary()) :: {:ok, PointCloud.t()} | {:error, Error.t()}
  def parse_file(file) do
    with {:ok, header, body} <- split_header(file),
         {:ok, fields, row} <- parse_fields(header),
         {:ok, count} <- point_count(header),
         {:ok, columns} <- read_columns(header["DATA"], fields, row, count, body) do
      build_cloud(fields, columns)
    else
      {:error, why} when is_binary(why) -> file_error(why)
      {:error, %Error{}} = error -> error
    end
  catch
    {:bad, why} -> file_error(why)
  end

  defp file_error(why),
    do: {:error, Error.new(:bad_file, "invalid PCD file", why: why)}

  # The header ends with the line that begins with DATA.
  defp split_header(file) do
    case Regex.run(
           ~r/^DATA +(\w+)[ \t]*\r?\n/m,
           binary_part(file, 0, min(byte_size(file), 65_536)),
           return: :index
         ) do
      [{at, size}, _] ->
        <<head::binary-pinned_size(at), line::binary-pinned_size(size), body::binary>> = file
        {:ok, parse_header(head <> line), body}

      nil ->
        {:error, "its header has no DATA line"}
    end
  end

  defp parse_header(text) do
    for line <- String.split(text, ["\r\n", "\n"], trim: true),
        not String.starts_with?(line, "#"),
        words = String.split(line),
        words != [],
        into: %{},
        do: {hd(words), tl(words)}
  end

  # {name, type, bytes per value, number of values, byte offset in a row}
  defp parse_fields(%{"FIELDS" => names, "SIZE" => sizes, "TYPE" => types} = header)
       when length(names) == length(sizes) and length(names) == length(types) and
              length(names) <= 100 do
    counts = header["COUNT"] || Enum.map(names, fn _ -> "1" end)

    if length(counts) == length(names),
      do: layout_fields(Enum.zip([names, types, sizes, counts])),
      else: {:error, "its header has #{length(names)} FIELDS, but a COUNT of #{length(counts)}"}
  end

  defp parse_fields(_header),
    do: {:error, "its header needs FIELDS, SIZE and TYPE of the same length"}

  defp layout_fields(rows) do
    rows
    |> Enum.reduce_while({:ok, [], 0}, fn {name, type, size, count}, {:ok, fields, at} ->
      case {Integer.parse(size), Integer.parse(count)} do
        {{size, ""}, {count, ""}} when size in [1, 2, 4, 8] and count in 1..10_000 ->
          {:cont, {:ok, [{name, type, size, count, at} | fields], at + size * count}}

        _ ->
          {:halt, {:error, "its field #{inspect(name)} has an invalid SIZE or COUNT"}}
      end
    end)
    |> case do
      {:ok, fields, row} -> check_coordinates(Enum.reverse(fields), row)
      error -> error
    end
  end

  defp check_coordinates(fields, row) do
    if Enum.all?(["x", "y", "z"], &List.keymember?(fields, &1, 0)),
      do: {:ok, fields, row},
      else: {:error, "its points have no x, y and z"}
  end

  defp point_count(%{"POINTS" => [text]}), do: parse_count(text)

  defp point_count(%{"WIDTH" => [width], "HEIGHT" => [height]}) do
    with {:ok, w} <- parse_count(width), {:ok, h} <- parse_count(height), do: {:ok, w * h}
  end

  defp point_count(_header), do: {:error, "its header does not state the number of points"}

  defp parse_count(text) do
    case Integer.parse(text) do
      {n, ""} when n in 0..@most_points -> {:ok, n}
      _ -> {:error, "#{inspect(text)} is not a valid number of points"}
    end
  end

  # Splits the points into rows of bytes, columns of bytes, or rows of words.
  defp read_columns(["binary"], _fields, row, count, body) do
    if byte_size(body) >= row * count,
      do: {:ok, {:rows, binary_part(body, 0, row * count), row, count}},
      else: {:error, "it is cut short: its header states #{count} points"}
  end

  defp read_columns(["binary_compressed"], _fields, row, count, body) do
    with <<packed::little-32, size::little-32, bytes::binary>> when byte_size(bytes) >= packed <-
           body,
         true <- size == row * count,
         {:ok, plain} <- decompress_lzf(binary_part(bytes, 0, packed), size) do
      {:ok, {:columns, plain, count}}
    else
      _ -> {:error, "its compressed points are damaged"}
    end
  end

  defp read_columns(["ascii"], fields, _row, count, body) do
    lines = body |> String.split(["\r\n", "\n"], trim: true) |> Enum.take(count)
    words = fields |> Enum.map(&elem(&1, 3)) |> Enum.sum()
    rows = Enum.map(lines, &String.split/1)

    cond do
      length(rows) < count -> {:error, "it is cut short: its header states #{count} points"}
      Enum.any?(rows, &(length(&1) != words)) -> {:error, "a line does not have #{words} numbers"}
      true -> {:ok, {:text, rows}}
    end
  end

  defp read_columns(data, _fields, _row, _count, _body),
    do: {:error, "its DATA is #{inspect(data)}, not ascii, binary or binary_compressed"}

  # LZF by M. Lehmann: literals of 1 to 32 bytes, or copies of 3 to 264 bytes from up to 8 KiB earlier. The header
  # bounds the size of the output.
  defp decompress_lzf(packed, size), do: decompress_step(packed, size, <<>>)

  defp decompress_step(<<>>, size, out),
    do: if(byte_size(out) == size, do: {:ok, out}, else: :error)

  defp decompress_step(_packed, size, out) when byte_size(out) > size, do: :error

  defp decompress_step(<<0::3, n::5, rest::binary>>, size, out) do
    case rest do
      <<literal::binary-pinned_size(n + 1), rest::binary>> ->
        decompress_step(rest, size, out <> literal)

      _ ->
        :error
    end
  end

  defp decompress_step(<<7::3, high::5, more, low, rest::binary>>, size, out),
    do: copy_reference(rest, size, out, 7 + more + 2, high * 256 + low + 1)

  defp decompress_step(<<n::3, high::5, low, rest::binary>>, size, out),
    do: copy_reference(rest, size, out, n + 2, high * 256 + low + 1)

  defp decompress_step(_packed, _size, _out), do: :error

  defp copy_reference(_rest, _size, out, _length, back) when back > byte_size(out), do: :error

  # A copy may overlap its own output; the available bytes are then repeated.
  defp copy_reference(rest, size, out, length, back) do
    part = binary_part(out, byte_size(out) - back, min(back, length))
    whole = String.duplicate(part, div(length, byte_size(part)) + 1)
    decompress_step(rest, size, out <> binary_part(whole, 0, length))
  end

  # The native kernel reads uncompressed binary points, because there may be millions of them.
  defp build_cloud(fields, {:rows, bytes, row, _count}) when row > 0 do
    numbers = fn names ->
      for name <- names,
          {_, type, size, _, at} <- [List.keyfind(fields, name, 0)],
          kind = %{"F" => :float, "I" => :int, "U" => :uint}[type],
          kind != nil and not (kind == :float and size < 4),
          do: {at, {kind, size}}
    end

    tone = List.keyfind(fields, "rgb", 0) || List.keyfind(fields, "rgba", 0)
    shone = numbers.(["intensity"])
    floats = &NativeCall.call_native(:record_floats, [bytes, row, &1, false])

    with [_, _, _] = places <- numbers.(["x", "y", "z"]),
         {:ok, points} <- floats.(places),
         {:ok, values} <- if(shone == [], do: {:ok, nil}, else: floats.(shone)) do
      PointCloud.new(points, tone && packed_colors(bytes, row, tone), values)
    else
      {:error, _} = error -> error
      _ -> file_error("its x, y and z have an unsupported type")
    end
  end

  defp build_cloud(fields, columns) do
    [x, y, z] =
      for name <- ["x", "y", "z"],
          do: field_values(List.keyfind(fields, name, 0), columns, fields)

    points =
      Enum.zip_with([x, y, z], fn row -> for(v <- row, into: <<>>, do: encode_float(v)) end)

    tone = List.keyfind(fields, "rgb", 0) || List.keyfind(fields, "rgba", 0)

    colors =
      tone && for(v <- field_values(tone, columns, fields), into: <<>>, do: encode_color(v, tone))

    shone = List.keyfind(fields, "intensity", 0)

    values =
      shone && for(v <- field_values(shone, columns, fields), into: <<>>, do: encode_float(v))

    PointCloud.new(IO.iodata_to_binary(points), colors, values)
  end

  defp packed_colors(bytes, row, {_, _, size, _, at}) do
    blue = for k <- [2, 1, 0], do: {at + k, {:uint, 1}}

    if size == 4,
      do: Error.unwrap!(NativeCall.call_native(:record_tones, [bytes, row, blue, false])),
      else: :binary.copy(<<0, 0, 0>>, div(byte_size(bytes), row))
  end

  # Compressed points are stored by column.
  defp field_values({_, type, size, many, at}, {:columns, bytes, count}, _fields) do
    for i <- 0..(count - 1)//1,
        do: decode_value(type, size, binary_part(bytes, at * count + i * size * many, size))
  end

  defp field_values({name, type, _, _, _}, {:text, rows}, fields) do
    before =
      fields |> Enum.take_while(&(elem(&1, 0) != name)) |> Enum.map(&elem(&1, 3)) |> Enum.sum()

    for row <- rows, do: parse_word(Enum.at(row, before), type)
  end

  defp decode_value("F", 4, <<x::little-float-32>>), do: x
  defp decode_value("F", 8, <<x::little-float-64>>), do: x

  defp decode_value("U", size, bytes),
    do: with(<<x::little-unit(8)-pinned_size(size)>> <- bytes, do: x)

  defp decode_value("I", size, bytes),
    do: with(<<x::little-signed-unit(8)-pinned_size(size)>> <- bytes, do: x)

  # Floats with NaN or infinite bits do not match the patterns above, and neither do unknown types.
  defp decode_value(_, 4, bytes), do: {:bits, bytes}
  defp decode_value(_, _, _), do: :nan

  defp parse_word(text, "F"), do: parse_number(text)

  defp parse_word(text, _) do
    case Integer.parse(text) do
      {n, ""} -> n
      _ -> parse_number(text)
    end
  end

  # A point with an infinite coordinate has no position, like a point with NaN.
  defp parse_number(text) do
    case NumberParser.parse_number(text) do
      {:ok, x} when is_float(x) -> x
      {:ok, _} -> :nan
      :error -> NumberParser.throw_no_number(text)
    end
  end

  defp encode_float(x) when is_number(x) and abs(x) < 3.4e38, do: <<x::little-float-32>>
  defp encode_float(_), do: @nan

  # A colour has 32 bits, and is usually written as the float with these bits.
  defp encode_color(x, {_, "F", 4, _, _}) when is_float(x) and abs(x) < 3.4e38,
    do: bgr_to_rgb(<<x::little-float-32>>)

  defp encode_color({:bits, bytes}, _), do: bgr_to_rgb(bytes)
  defp encode_color(n, _) when is_integer(n) and n >= 0, do: bgr_to_rgb(<<n::little-32>>)
  defp encode_color(_, _), do: <<0, 0, 0>>

  defp bgr_to_rgb(<<b, g, r, _>>), do: <<r, g, b>>
end

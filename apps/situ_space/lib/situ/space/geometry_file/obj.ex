defmodule Situ.Space.GeometryFile.Obj do
  @moduledoc false
  # Parses OBJ by Wavefront: the lines `v x y z` (optionally with a colour) and `f a b c ...`. Normals, textures,
  # materials and curves are skipped. Vertex numbers start at 1; negative ones count back from the last vertex.
  alias Situ.{Error, Mesh, PointCloud}
  alias Situ.Space.GeometryFile.NumberParser

  @most 50_000_000

  @doc "Returns a mesh if there are faces, or else a point cloud."
  @spec parse_file(binary()) :: {:ok, Mesh.t() | PointCloud.t()} | {:error, Error.t()}
  def parse_file(text) do
    {vertices, colors, faces, count} =
      text
      |> join_lines()
      |> String.split(["\r\n", "\n"], trim: true)
      |> Enum.reduce({[], [], [], 0}, &parse_line(String.split(&1), &2))

    points = vertices |> Enum.reverse() |> IO.iodata_to_binary()

    cond do
      count == 0 -> file_error("it has no vertices")
      faces == [] -> PointCloud.new(points, encode_colors(colors, count))
      true -> Mesh.new(points, faces |> Enum.reverse() |> IO.iodata_to_binary())
    end
  catch
    {:bad, why} -> file_error(why)
  end

  # A backslash at the end of a line continues it on the next line.
  defp join_lines(text) do
    if :binary.match(text, "\\") == :nomatch,
      do: text,
      else: String.replace(text, ["\\\r\n", "\\\n"], " ")
  end

  defp file_error(why),
    do: {:error, Error.new(:bad_file, "invalid OBJ file", why: why)}

  defp parse_line(["v", x, y, z | more], {vertices, colors, faces, count}) when count < @most do
    place =
      for word <- [x, y, z],
          into: <<>>,
          do: <<NumberParser.parse_coordinate!(word)::little-float-32>>

    {[place | vertices], add_color(more, colors), faces, count + 1}
  end

  defp parse_line(["v" | _], _acc), do: throw({:bad, "a vertex has fewer than three numbers"})

  # Polygons are split into fans of triangles.
  defp parse_line(["f", a, b, c | more], {vertices, colors, faces, count}) do
    [a | others] = Enum.map([a, b, c | more], &parse_index(&1, count))

    fan =
      for {b, c} <- Enum.zip(others, tl(others)),
          into: <<>>,
          do: <<a::little-32, b::little-32, c::little-32>>

    {vertices, colors, [fan | faces], count}
  end

  defp parse_line(["f" | _], _acc), do: throw({:bad, "a face has fewer than three vertices"})
  defp parse_line(_words, acc), do: acc

  defp add_color([r, g, b], colors),
    do: [for(word <- [r, g, b], into: <<>>, do: <<parse_color_byte(word)>>) | colors]

  defp add_color(_weight, colors), do: colors

  # Scanners write NaN for colours that were not measured.
  defp parse_color_byte(word) do
    case NumberParser.parse_number(word) do
      {:ok, x} when is_float(x) -> round(255 * (x |> max(0.0) |> min(1.0)))
      {:ok, :infinity} -> 255
      {:ok, _} -> 0
      :error -> NumberParser.throw_no_number(word)
    end
  end

  # If only some vertices have colours, they cannot be assigned to vertices.
  defp encode_colors(colors, count) when length(colors) == count,
    do: colors |> Enum.reverse() |> IO.iodata_to_binary()

  defp encode_colors(_colors, _count), do: nil

  defp parse_index(word, count) do
    case Integer.parse(word) do
      {n, rest} when n in 1..count//1 and (rest == "" or binary_part(rest, 0, 1) == "/") ->
        n - 1

      {n, rest} when n < 0 and n >= -count and (rest == "" or binary_part(rest, 0, 1) == "/") ->
        count + n

      _ ->
        throw({:bad, "a face refers to vertex #{inspect(String.slice(word, 0, 40))} of #{count}"})
    end
  end
end

defmodule Situ.Space.GeometryFile.Stl do
  @moduledoc false
  # Parses STL by 3D Systems, as binary or text: triangles that do not share corners. Normals and attributes are
  # skipped, and vertices at the same position are merged.
  alias Situ.{Error, Mesh}
  alias Situ.Space.GeometryFile.NumberParser

  @most 20_000_000

  @spec parse_file(binary()) :: {:ok, Mesh.t()} | {:error, Error.t()}
  # Some programs begin binary files with "solid" as well, so the size decides.
  def parse_file(<<_head::binary-size(80), count::little-32, body::binary>>)
      when byte_size(body) == count * 50 and count in 1..@most do
    corners =
      for <<_normal::binary-size(12), corners::binary-size(36), _::16 <- body>>,
        into: <<>>,
        do: corners

    if all_finite?(corners),
      do: build_mesh(for <<corner::binary-size(12) <- corners>>, do: corner),
      else: file_error("a corner's coordinates are not finite")
  end

  def parse_file("solid" <> _ = text) do
    corners =
      for ["vertex" | numbers] <- text |> String.split("\n") |> Stream.map(&String.split/1),
          do: parse_corner(numbers)

    if corners != [] and rem(length(corners), 3) == 0,
      do: build_mesh(corners),
      else: file_error("its vertices do not form triangles")
  catch
    {:bad, why} -> file_error(why)
  end

  def parse_file(_bytes), do: file_error("its size does not match its number of triangles")

  defp file_error(why),
    do: {:error, Error.new(:bad_file, "invalid STL file", why: why)}

  defp all_finite?(<<_::little-float-32, rest::binary>>), do: all_finite?(rest)
  defp all_finite?(rest), do: rest == ""

  defp parse_corner([_, _, _] = words) do
    for word <- words, into: <<>>, do: <<NumberParser.parse_coordinate!(word)::little-float-32>>
  end

  defp parse_corner(_words), do: throw({:bad, "a vertex does not have three numbers"})

  defp build_mesh(corners) do
    {indices, {vertices, _}} =
      Enum.map_reduce(corners, {[], %{}}, fn corner, {vertices, places} ->
        case places do
          %{^corner => i} ->
            {<<i::little-32>>, {vertices, places}}

          _ ->
            i = map_size(places)
            {<<i::little-32>>, {[corner | vertices], Map.put(places, corner, i)}}
        end
      end)

    Mesh.new(vertices |> Enum.reverse() |> IO.iodata_to_binary(), IO.iodata_to_binary(indices))
  end
end

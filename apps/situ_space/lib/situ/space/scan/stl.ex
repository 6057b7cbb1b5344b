defmodule Situ.Space.Scan.Stl do
  @moduledoc false
  # Parses STL by 3D Systems, as binary or text: triangles that do not share corners. Normals and attributes are
  # skipped, and vertices at the same position are merged.
  alias Situ.{Error, Mesh}
  alias Situ.Space.Scan.Text

  @most 20_000_000

  @spec read(binary()) :: {:ok, Mesh.t()} | {:error, Error.t()}
  # Some programs begin binary files with "solid" as well, so the size decides.
  def read(<<_head::binary-size(80), count::little-32, body::binary>>)
      when byte_size(body) == count * 50 and count in 1..@most do
    corners =
      for <<_normal::binary-size(12), corners::binary-size(36), _::16 <- body>>,
        into: <<>>,
        do: corners

    if finite?(corners),
      do: joined(for <<corner::binary-size(12) <- corners>>, do: corner),
      else: bad("a corner's coordinates are not finite")
  end

  def read("solid" <> _ = text) do
    corners =
      for ["vertex" | numbers] <- text |> String.split("\n") |> Stream.map(&String.split/1),
          do: corner(numbers)

    if corners != [] and rem(length(corners), 3) == 0,
      do: joined(corners),
      else: bad("its vertices do not form triangles")
  catch
    {:bad, why} -> bad(why)
  end

  def read(_bytes), do: bad("its size does not match its number of triangles")

  defp bad(why),
    do: {:error, Error.new(:bad_file, "invalid STL file", why: why)}

  defp finite?(<<_::little-float-32, rest::binary>>), do: finite?(rest)
  defp finite?(rest), do: rest == ""

  defp corner([_, _, _] = words) do
    for word <- words, into: <<>>, do: <<Text.parse_coordinate!(word)::little-float-32>>
  end

  defp corner(_words), do: throw({:bad, "a vertex does not have three numbers"})

  defp joined(corners) do
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

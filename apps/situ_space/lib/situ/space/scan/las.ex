defmodule Situ.Space.Scan.Las do
  @moduledoc false
  # LAS 1.0 to 1.4, not compressed: places as whole numbers with a scale, colours where the point format has them.
  # Source: ASPRS, LAS Specification 1.4 R15.
  import Situ.Bits, only: [known: 1]
  alias Situ.{Error, PointCloud}

  # Where the colours of a point begin, by its format.
  @colors %{2 => 20, 3 => 28, 5 => 28, 7 => 30, 8 => 30, 10 => 30}
  @sizes %{
    0 => 20,
    1 => 28,
    2 => 26,
    3 => 34,
    4 => 57,
    5 => 63,
    6 => 30,
    7 => 36,
    8 => 38,
    9 => 59,
    10 => 67
  }

  @doc "The points, relative to the lower corner of the file's bounds, and that corner."
  @spec read(binary()) :: {:ok, PointCloud.t(), origin :: tuple()} | {:error, Error.t()}
  def read(
        <<"LASF", _::binary-size(20), 1, minor, _::binary-size(68), _header::little-16,
          at::little-32, _::32, format, size::little-16, count::little-32, _::binary-size(20),
          sx::little-float-64, sy::little-float-64, sz::little-float-64, ox::little-float-64,
          oy::little-float-64, oz::little-float-64, _::64, lx::little-float-64, _::64,
          ly::little-float-64, _::64, lz::little-float-64, _::binary>> = file
      ) do
    count = if minor >= 4 and count == 0, do: long_count(file), else: count

    cond do
      format >= 128 ->
        bad("it is compressed (LAZ)", "unpack it: laszip -i FILE.laz -o FILE.las")

      not is_map_key(@sizes, format) ->
        bad("its point format #{format} is not known")

      size < @sizes[format] ->
        bad("its points have #{size} bytes, format #{format} needs #{@sizes[format]}")

      at + count * size > byte_size(file) ->
        bad("it is cut short: #{count} points are announced")

      true ->
        cloud(
          binary_part(file, at, count * size),
          size,
          format,
          {{sx, ox - lx}, {sy, oy - ly}, {sz, oz - lz}},
          {lx, ly, lz}
        )
    end
  rescue
    _ in [ArgumentError, ArithmeticError] -> bad("its points lie farther apart than can be told")
  end

  def read(_file), do: bad("its header is none")

  defp long_count(<<_::binary-size(247), count::little-64, _::binary>>), do: count
  defp long_count(_short), do: 0

  defp cloud(points, size, format, {{sx, ox}, {sy, oy}, {sz, oz}}, origin) do
    rest = size - 12

    places =
      for <<x::little-signed-32, y::little-signed-32, z::little-signed-32,
            _::binary-known(rest) <- points>>,
          into: <<>> do
        <<x * sx + ox::little-float-32, y * sy + oy::little-float-32,
          z * sz + oz::little-float-32>>
      end

    with {:ok, cloud} <- PointCloud.new(places, colors(points, size, @colors[format])),
         do: {:ok, cloud, origin}
  end

  defp colors(_points, _size, nil), do: nil

  # 16 bits each; many writers use only the lower 8.
  defp colors(points, size, at) do
    rest = size - at - 6

    all =
      for <<_::binary-known(at), r::little-16, g::little-16, b::little-16,
            _::binary-known(rest) <- points>>,
          do: {r, g, b}

    wide? = Enum.any?(all, fn {r, g, b} -> r > 255 or g > 255 or b > 255 end)
    by = if wide?, do: 256, else: 1

    if Enum.any?(all, &(&1 != {0, 0, 0})),
      do: for({r, g, b} <- all, into: <<>>, do: <<div(r, by), div(g, by), div(b, by)>>)
  end

  defp bad(why, fix \\ nil),
    do: {:error, Error.new(:bad_file, "this is no LAS file that can be read", why: why, fix: fix)}
end

defmodule Situ.Space.GeometryFile.Las do
  @moduledoc false
  # Parses LAS 1.0 to 1.4, compressed (LAZ) or not: positions as scaled integers, and colours if the format has them.
  # Source: ASPRS, LAS Specification 1.4 R15.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.{Error, PointCloud}
  alias Situ.Space.NativeCall

  # The byte offset of the colours in a point record, by format.
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

  @doc "Returns the points, relative to the lower corner of the file's bounds, and that corner."
  @spec parse_file(binary()) :: {:ok, PointCloud.t(), origin :: tuple()} | {:error, Error.t()}
  def parse_file(
        <<"LASF", _::binary-size(20), 1, minor, _::binary-size(68), _header::little-16,
          at::little-32, _::32, format, size::little-16, count::little-32, _::binary-size(20),
          sx::little-float-64, sy::little-float-64, sz::little-float-64, ox::little-float-64,
          oy::little-float-64, oz::little-float-64, _::64, lx::little-float-64, _::64,
          ly::little-float-64, _::64, lz::little-float-64, _::binary>> = file
      ) do
    count = if minor >= 4 and count == 0, do: long_count(file), else: count

    {packed?, format} = {format >= 128, rem(format, 64)}

    with :ok <- check_format(format, size),
         {:ok, records} <- read_records(file, packed?, at, size, count),
         scale = {sx, sy, sz},
         colors = Map.get(@colors, format, -1),
         arguments = [records, size, colors, scale, {ox - lx, oy - ly, oz - lz}],
         {:ok, {points, colors, shone}} <- NativeCall.call_native(:las_points, arguments),
         {:ok, cloud} <- PointCloud.new(points, nil_if_empty(colors), nil_if_empty(shone)) do
      {:ok, cloud, {lx, ly, lz}}
    else
      {:error, %Error{code: :bad_file}} = bad -> bad
      {:error, %Error{what: what}} -> file_error(what)
    end
  rescue
    ArithmeticError -> file_error("its coordinates are out of range")
  end

  def parse_file(_file), do: file_error("its header is invalid")

  defp nil_if_empty(bytes), do: if(bytes != <<>>, do: bytes)

  defp check_format(format, size) do
    cond do
      not is_map_key(@sizes, format) ->
        file_error("its point format #{format} is unknown")

      size < @sizes[format] ->
        file_error(
          "its point records have #{size} bytes, but format #{format} needs #{@sizes[format]}"
        )

      true ->
        :ok
    end
  end

  defp read_records(file, false, at, size, count) do
    if at + count * size <= byte_size(file),
      do: {:ok, binary_part(file, at, count * size)},
      else: file_error("it is cut short: its header states #{count} points")
  end

  defp read_records(file, true, at, size, count) do
    case find_packing(file) do
      nil ->
        file_error("it is compressed, but the record that describes the compression is missing")

      packing ->
        NativeCall.call_native(:las_unpack, [file, {at, size, count}, packing])
    end
  end

  # Finds the record between header and points that describes the compression.
  defp find_packing(
         <<_::binary-size(94), header::little-16, _::little-32, count::little-32, _::binary>> =
           file
       ),
       do: search_packing(file, header, count)

  defp search_packing(file, at, count) when count > 0 and at <= byte_size(file) do
    case binary_part(file, at, byte_size(file) - at) do
      <<_::16, "laszip encoded\0\0", 22_204::little-16, size::little-16, _::binary-size(32),
        packing::binary-pinned_size(size), _::binary>> ->
        packing

      <<_::binary-size(20), size::little-16, _::binary-size(32), _::binary>> ->
        search_packing(file, at + 54 + size, count - 1)

      _ ->
        nil
    end
  end

  defp search_packing(_file, _at, _count), do: nil

  defp long_count(<<_::binary-size(247), count::little-64, _::binary>>), do: count
  defp long_count(_short), do: 0

  defp file_error(why),
    do: {:error, Error.new(:bad_file, "invalid LAS file", why: why)}
end

defmodule Situ.Bridge.Parquet.Compression do
  @moduledoc false
  # Unpacks a compressed page, up to the size that its header declares. Throws `{:not_parquet, why}`.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.{Gzip, Native}
  alias Situ.Bridge.Parquet.Thrift

  @names %{3 => "LZO", 4 => "Brotli"}

  @doc "Unpacks a page of `size` bytes."
  @spec unpack_page(codec :: integer(), binary(), size :: non_neg_integer()) :: binary()
  def unpack_page(0, bytes, _size), do: bytes
  # Some writers store an empty page as no bytes at all.
  def unpack_page(codec, "", 0) when codec not in [3, 4], do: ""
  def unpack_page(1, bytes, size), do: check_size(unpack_snappy(bytes, size), size)
  def unpack_page(2, bytes, size), do: check_size(unpack_gzip(bytes, size), size)

  # Writers disagree on the deprecated LZ4 codec: they use Hadoop's framing or a plain block.
  def unpack_page(5, bytes, size) do
    case unpack_hadoop_lz4(bytes, size, []) do
      {:ok, unpacked} -> unpacked
      :error -> unpack_native("lz4_block", bytes, size)
    end
  end

  def unpack_page(6, bytes, size), do: unpack_native("zstd", bytes, size)
  def unpack_page(7, bytes, size), do: unpack_native("lz4_block", bytes, size)

  def unpack_page(codec, _bytes, _size),
    do:
      throw_malformed(
        "pages are compressed with #{@names[codec] || codec}; supported are none, Snappy, gzip, zstd and LZ4"
      )

  defp unpack_native(codec, bytes, size) do
    case Native.unpack(codec, bytes, size) do
      {:ok, bytes} -> check_size(bytes, size)
      {:error, why} -> throw_malformed("a page compressed with #{codec}: #{inspect(why)}")
    end
  end

  # Each block is preceded by its uncompressed and its compressed size, both big-endian.
  defp unpack_hadoop_lz4("", 0, blocks),
    do: {:ok, blocks |> Enum.reverse() |> IO.iodata_to_binary()}

  defp unpack_hadoop_lz4(<<n::32, packed::32, rest::binary>>, remaining, blocks)
       when n in 1..remaining//1 and packed <= byte_size(rest) do
    <<block::binary-pinned_size(packed), rest::binary>> = rest

    case Native.unpack("lz4_block", block, n) do
      {:ok, bytes} when byte_size(bytes) == n ->
        unpack_hadoop_lz4(rest, remaining - n, [bytes | blocks])

      _ ->
        :error
    end
  end

  defp unpack_hadoop_lz4(_bytes, _remaining, _blocks), do: :error

  defp check_size(bytes, size) when byte_size(bytes) == size, do: bytes

  defp check_size(_bytes, _size),
    do: throw_malformed("a page does not unpack to its declared size")

  defp unpack_gzip(bytes, size) do
    case Gzip.unpack_limited(bytes, size) do
      {:ok, bytes} -> bytes
      {:error, :too_large} -> throw_malformed("a page unpacks to more than its declared size")
      {:error, :not_gzip} -> throw_malformed("a page declared as gzip is not gzip")
    end
  end

  # Snappy (https://github.com/google/snappy/blob/main/format_description.txt): literals, and copies of earlier
  # output.
  defp unpack_snappy(bytes, size) do
    {n, rest} = Thrift.decode_varint(bytes)
    if n != size, do: throw_malformed("a page compressed with Snappy has a different size")
    snappy_elements(rest, <<>>, size)
  end

  defp snappy_elements("", output, _size), do: output

  defp snappy_elements(<<n::6, 0::2, rest::binary>>, output, size) when n < 60,
    do: append_literal(rest, n + 1, output, size)

  defp snappy_elements(<<n::6, 0::2, rest::binary>>, output, size) do
    bytes = n - 59

    case rest do
      <<length::little-pinned_size(bytes)-unit(8), rest::binary>> ->
        append_literal(rest, length + 1, output, size)

      _ ->
        throw_malformed("a page compressed with Snappy is truncated")
    end
  end

  defp snappy_elements(<<high::3, n::3, 1::2, low, rest::binary>>, output, size),
    do: append_copy(rest, high * 256 + low, n + 4, output, size)

  defp snappy_elements(<<n::6, 2::2, distance::little-16, rest::binary>>, output, size),
    do: append_copy(rest, distance, n + 1, output, size)

  defp snappy_elements(<<n::6, 3::2, distance::little-32, rest::binary>>, output, size),
    do: append_copy(rest, distance, n + 1, output, size)

  defp snappy_elements(_short, _out, _size),
    do: throw_malformed("a page compressed with Snappy is truncated")

  defp append_literal(rest, n, output, size) when byte_size(output) + n <= size do
    case rest do
      <<part::binary-pinned_size(n), rest::binary>> ->
        snappy_elements(rest, <<output::binary, part::binary>>, size)

      _ ->
        throw_malformed("a page compressed with Snappy is truncated")
    end
  end

  defp append_literal(_rest, _n, _out, _size),
    do: throw_malformed("a page unpacks to more than its declared size")

  defp append_copy(rest, distance, n, output, size)
       when distance in 1..byte_size(output)//1 and byte_size(output) + n <= size do
    part = binary_part(output, byte_size(output) - distance, min(distance, n))
    # A copy may overlap its own output; then the bytes repeat.
    part =
      if distance < n, do: binary_part(:binary.copy(part, div(n, distance) + 1), 0, n), else: part

    snappy_elements(rest, <<output::binary, part::binary>>, size)
  end

  defp append_copy(_rest, _back, _n, _out, _size),
    do: throw_malformed("a page compressed with Snappy has a copy out of range")

  defp throw_malformed(why), do: throw({:not_parquet, why})
end

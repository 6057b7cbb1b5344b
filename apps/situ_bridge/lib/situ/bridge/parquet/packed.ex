defmodule Situ.Bridge.Parquet.Packed do
  @moduledoc false
  # Unpacks a compressed page, up to the size that its header declares. Throws `{:not_parquet, why}`.
  import Situ.Bits, only: [known: 1]
  alias Situ.Bridge.{Gzip, Native}
  alias Situ.Bridge.Parquet.Thrift

  @names %{3 => "LZO", 4 => "Brotli"}

  @doc "Unpacks a page of `size` bytes."
  @spec undo(codec :: integer(), binary(), size :: non_neg_integer()) :: binary()
  def undo(0, bytes, _size), do: bytes
  # Some writers store an empty page as no bytes at all.
  def undo(codec, "", 0) when codec not in [3, 4], do: ""
  def undo(1, bytes, size), do: exactly(snappy(bytes, size), size)
  def undo(2, bytes, size), do: exactly(gunzip(bytes, size), size)

  # Writers disagree on the deprecated LZ4 codec: they use Hadoop's framing or a plain block.
  def undo(5, bytes, size) do
    case hadoop(bytes, size, []) do
      {:ok, unpacked} -> unpacked
      :error -> native("lz4_block", bytes, size)
    end
  end

  def undo(6, bytes, size), do: native("zstd", bytes, size)
  def undo(7, bytes, size), do: native("lz4_block", bytes, size)

  def undo(codec, _bytes, _size),
    do:
      fail(
        "pages are compressed with #{@names[codec] || codec}; supported are none, Snappy, gzip, zstd and LZ4"
      )

  defp native(codec, bytes, size) do
    case Native.unpack(codec, bytes, size) do
      {:ok, bytes} -> exactly(bytes, size)
      {:error, why} -> fail("a page compressed with #{codec}: #{inspect(why)}")
    end
  end

  # Each block is preceded by its uncompressed and its compressed size, both big-endian.
  defp hadoop("", 0, blocks), do: {:ok, blocks |> Enum.reverse() |> IO.iodata_to_binary()}

  defp hadoop(<<n::32, packed::32, rest::binary>>, left, blocks)
       when n in 1..left//1 and packed <= byte_size(rest) do
    <<block::binary-known(packed), rest::binary>> = rest

    case Native.unpack("lz4_block", block, n) do
      {:ok, bytes} when byte_size(bytes) == n -> hadoop(rest, left - n, [bytes | blocks])
      _ -> :error
    end
  end

  defp hadoop(_bytes, _left, _blocks), do: :error

  defp exactly(bytes, size) when byte_size(bytes) == size, do: bytes
  defp exactly(_bytes, _size), do: fail("a page does not unpack to its declared size")

  defp gunzip(bytes, size) do
    case Gzip.unpack(bytes, size) do
      {:ok, bytes} -> bytes
      {:error, :too_large} -> fail("a page unpacks to more than its declared size")
      {:error, :not_gzip} -> fail("a page declared as gzip is not gzip")
    end
  end

  # Snappy (https://github.com/google/snappy/blob/main/format_description.txt): literals, and copies of earlier
  # output.
  defp snappy(bytes, size) do
    {n, rest} = Thrift.unsigned(bytes)
    if n != size, do: fail("a page compressed with Snappy has a different size")
    elements(rest, <<>>, size)
  end

  defp elements("", out, _size), do: out

  defp elements(<<n::6, 0::2, rest::binary>>, out, size) when n < 60,
    do: literal(rest, n + 1, out, size)

  defp elements(<<n::6, 0::2, rest::binary>>, out, size) do
    bytes = n - 59

    case rest do
      <<length::little-known(bytes)-unit(8), rest::binary>> ->
        literal(rest, length + 1, out, size)

      _ ->
        fail("a page compressed with Snappy is truncated")
    end
  end

  defp elements(<<high::3, n::3, 1::2, low, rest::binary>>, out, size),
    do: copy(rest, high * 256 + low, n + 4, out, size)

  defp elements(<<n::6, 2::2, back::little-16, rest::binary>>, out, size),
    do: copy(rest, back, n + 1, out, size)

  defp elements(<<n::6, 3::2, back::little-32, rest::binary>>, out, size),
    do: copy(rest, back, n + 1, out, size)

  defp elements(_short, _out, _size), do: fail("a page compressed with Snappy is truncated")

  defp literal(rest, n, out, size) when byte_size(out) + n <= size do
    case rest do
      <<part::binary-known(n), rest::binary>> ->
        elements(rest, <<out::binary, part::binary>>, size)

      _ ->
        fail("a page compressed with Snappy is truncated")
    end
  end

  defp literal(_rest, _n, _out, _size), do: fail("a page unpacks to more than its declared size")

  defp copy(rest, back, n, out, size)
       when back in 1..byte_size(out)//1 and byte_size(out) + n <= size do
    part = binary_part(out, byte_size(out) - back, min(back, n))
    # A copy may overlap its own output; then the bytes repeat.
    part = if back < n, do: binary_part(:binary.copy(part, div(n, back) + 1), 0, n), else: part
    elements(rest, <<out::binary, part::binary>>, size)
  end

  defp copy(_rest, _back, _n, _out, _size),
    do: fail("a page compressed with Snappy has a copy out of range")

  defp fail(why), do: throw({:not_parquet, why})
end

defmodule Situ.Bridge.Arrow.Buffer do
  @moduledoc false
  # The bytes of a column in a batch. Uncompressed buffers are read from the file on demand, compressed buffers are
  # unpacked into memory. Throws `{:not_arrow, why}`.
  alias Situ.Bridge.Native

  @max_bytes 1_073_741_824
  @codecs %{0 => "lz4", 1 => "zstd"}

  @typedoc "The size of the buffer, and a function that reads `n` bytes at an offset."
  @type t ::
          {size :: non_neg_integer(),
           (at :: non_neg_integer(), n :: non_neg_integer() -> binary())}

  @spec from_binary(binary()) :: t()
  def from_binary(bytes), do: {byte_size(bytes), &binary_part(bytes, &1, &2)}

  @doc "Returns the uncompressed buffer."
  @spec unpack_buffer(t(), codec :: integer() | nil) :: t()
  def unpack_buffer(buffer, nil), do: buffer
  def unpack_buffer({0, _read} = buffer, _codec), do: buffer

  def unpack_buffer({size, read}, codec) when size >= 8 and is_map_key(@codecs, codec) do
    case read.(0, 8) do
      <<-1::little-signed-64>> -> {size - 8, &read.(&1 + 8, &2)}
      <<n::little-signed-64>> -> from_binary(unpack_bytes(@codecs[codec], read.(8, size - 8), n))
    end
  end

  def unpack_buffer(_buffer, _codec),
    do: throw_malformed("a buffer is compressed with an unknown codec")

  defp unpack_bytes(codec, bytes, size) when size in 0..@max_bytes do
    case Native.unpack(codec, bytes, size) do
      {:ok, unpacked} when byte_size(unpacked) == size -> unpacked
      {:ok, _} -> throw_malformed("a buffer does not unpack to its declared size")
      {:error, why} -> throw_malformed("a buffer cannot be unpacked: #{inspect(why)}")
    end
  end

  defp unpack_bytes(_codec, _bytes, size),
    do: throw_malformed("a buffer claims to unpack to #{size} bytes")

  @doc """
  Reads `n` bytes at the offset `at`.

      iex> alias Situ.Bridge.Arrow.Buffer
      iex> Buffer.read_bytes(Buffer.from_binary("abcdef"), 2, 3)
      "cde"
  """
  @spec read_bytes(t(), integer(), integer()) :: binary()
  def read_bytes(_buffer, _at, 0), do: ""
  def read_bytes({size, read}, at, n) when at >= 0 and n > 0 and at + n <= size, do: read.(at, n)
  def read_bytes(_buffer, _at, _n), do: throw_malformed("a buffer is too short for its rows")

  defp throw_malformed(why), do: throw({:not_arrow, why})
end

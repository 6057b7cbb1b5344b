defmodule Situ.Bridge.Gzip do
  @moduledoc false
  # Unpacks gzip step by step up to a size limit, so that a small input cannot fill the memory. Several members in a
  # row are unpacked as one text (RFC 1952).

  @doc """
  Unpacks gzip into at most `max_size` bytes.

      iex> packed = :zlib.gzip("aaaaaaaaaa")
      iex> {Situ.Bridge.Gzip.unpack_limited(packed, 10), Situ.Bridge.Gzip.unpack_limited(packed, 9)}
      {{:ok, "aaaaaaaaaa"}, {:error, :too_large}}
      iex> Situ.Bridge.Gzip.unpack_limited("no gzip", 9)
      {:error, :not_gzip}
      iex> Situ.Bridge.Gzip.unpack_limited(:zlib.gzip("one, ") <> :zlib.gzip("two"), 9)
      {:ok, "one, two"}
  """
  @spec unpack_limited(binary(), non_neg_integer()) ::
          {:ok, binary()} | {:error, :too_large | :not_gzip}
  def unpack_limited(packed, max_size) do
    z = :zlib.open()

    try do
      :zlib.inflateInit(z, 31, :reset)
      inflate_rest(z, :zlib.safeInflate(z, packed), max_size, [])
    rescue
      ErlangError -> {:error, :not_gzip}
    after
      :zlib.close(z)
    end
  end

  defp inflate_rest(z, {state, chunk}, max_size, chunks) do
    remaining = max_size - IO.iodata_length(chunk)

    cond do
      remaining < 0 -> {:error, :too_large}
      state == :finished -> {:ok, IO.iodata_to_binary(Enum.reverse([chunk | chunks]))}
      true -> inflate_rest(z, :zlib.safeInflate(z, []), remaining, [chunk | chunks])
    end
  end
end

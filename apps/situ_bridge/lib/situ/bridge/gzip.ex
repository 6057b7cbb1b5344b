defmodule Situ.Bridge.Gzip do
  @moduledoc false
  # Unpacks gzip step by step up to a size limit, so that a small input cannot fill the memory. Several members in a
  # row are unpacked as one text (RFC 1952).

  @doc """
  Unpacks gzip into at most `most` bytes.

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
  def unpack_limited(packed, most) do
    z = :zlib.open()

    try do
      :zlib.inflateInit(z, 31, :reset)
      inflate_rest(z, :zlib.safeInflate(z, packed), most, [])
    rescue
      ErlangError -> {:error, :not_gzip}
    after
      :zlib.close(z)
    end
  end

  defp inflate_rest(z, {state, out}, most, all) do
    left = most - IO.iodata_length(out)

    cond do
      left < 0 -> {:error, :too_large}
      state == :finished -> {:ok, IO.iodata_to_binary(Enum.reverse([out | all]))}
      true -> inflate_rest(z, :zlib.safeInflate(z, []), left, [out | all])
    end
  end
end

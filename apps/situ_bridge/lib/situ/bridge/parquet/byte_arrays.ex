defmodule Situ.Bridge.Parquet.ByteArrays do
  @moduledoc false
  # Decodes strings with separate lengths (DELTA_LENGTH_BYTE_ARRAY), strings that share a prefix with the previous
  # string (DELTA_BYTE_ARRAY), and values with separated bytes (BYTE_STREAM_SPLIT). Pure. Throws
  # `{:not_parquet, why}`.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Parquet.RunLength

  # The maximum size of a decoded page: shared prefixes can expand a few bytes into a huge amount of data.
  @max_bytes 268_435_456

  @doc "Decodes at most `max` strings whose lengths are stored before them."
  @spec decode_texts(binary(), max :: non_neg_integer()) :: [binary()]
  def decode_texts(bytes, max) do
    {lengths, rest} = RunLength.decode_deltas(bytes, max, 32)

    {texts, _rest} =
      Enum.map_reduce(lengths, rest, fn length, rest ->
        case rest do
          <<text::binary-pinned_size(length), rest::binary>> when length >= 0 ->
            {:binary.copy(text), rest}

          _ ->
            throw_malformed("a string is truncated")
        end
      end)

    texts
  end

  @doc "Decodes at most `max` strings that share a prefix with the previous string."
  @spec decode_prefixed_texts(binary(), max :: non_neg_integer()) :: [binary()]
  def decode_prefixed_texts(bytes, max) do
    {lengths, rest} = RunLength.decode_deltas(bytes, max, 32)
    suffixes = decode_texts(rest, max)

    if length(lengths) != length(suffixes),
      do: throw_malformed("strings have a prefix but no suffix")

    {texts, _} =
      lengths
      |> Enum.zip(suffixes)
      |> Enum.map_reduce({"", 0}, fn {prefix_size, suffix}, {previous, size} ->
        size = size + prefix_size + byte_size(suffix)

        if prefix_size not in 0..byte_size(previous) or size > @max_bytes,
          do: throw_malformed("the shared prefix of a string is too long")

        text = binary_part(previous, 0, prefix_size) <> suffix
        {text, {text, size}}
      end)

    texts
  end

  @doc """
  Joins the bytes of the values `from` to `from + n - 1`. The input holds the first bytes of all values, then all
  second bytes, and so on.

      iex> Situ.Bridge.Parquet.ByteArrays.join_bytes(<<1, 2, 3, 4, 5, 6>>, 2, 1, 2)
      <<2, 5, 3, 6>>
  """
  @spec join_bytes(
          binary(),
          width :: pos_integer(),
          from :: non_neg_integer(),
          n :: non_neg_integer()
        ) ::
          binary()
  def join_bytes(bytes, width, from, n) do
    count = div(byte_size(bytes), width)
    if from + n > count, do: throw_malformed("a page has too few values")

    for(
      i <- 0..(width - 1)//1,
      do: bytes |> binary_part(i * count + from, n) |> :binary.bin_to_list()
    )
    |> Enum.zip_with(&:binary.list_to_bin/1)
    |> IO.iodata_to_binary()
  end

  defp throw_malformed(why), do: throw({:not_parquet, why})
end

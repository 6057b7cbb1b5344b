defmodule Situ.Bridge.Parquet.Deltas do
  @moduledoc false
  # Texts whose lengths stand before them (DELTA_LENGTH_BYTE_ARRAY), texts that begin like the one before
  # (DELTA_BYTE_ARRAY), and values whose bytes are apart (BYTE_STREAM_SPLIT). Pure. Throws `{:not_parquet, why}`.
  import Situ.Bits, only: [known: 1]
  alias Situ.Bridge.Parquet.Runs

  # The most bytes that a page may become: prefixes can repeat much with few bytes.
  @most 268_435_456

  @spec texts(binary(), non_neg_integer()) :: [binary()]
  def texts(bytes, n) do
    {lengths, rest} = counted(bytes, n)

    {texts, _rest} =
      Enum.map_reduce(lengths, rest, fn length, rest ->
        case rest do
          <<text::binary-known(length), rest::binary>> when length >= 0 ->
            {:binary.copy(text), rest}

          _ ->
            fail("a text that is cut short")
        end
      end)

    texts
  end

  @spec prefixed(binary(), non_neg_integer()) :: [binary()]
  def prefixed(bytes, n) do
    {lengths, rest} = counted(bytes, n)

    {texts, _} =
      lengths
      |> Enum.zip(texts(rest, n))
      |> Enum.map_reduce({"", 0}, fn {shared, suffix}, {before, size} ->
        size = size + shared + byte_size(suffix)

        if shared not in 0..byte_size(before) or size > @most,
          do: fail("texts that begin like more than the one before")

        text = binary_part(before, 0, shared) <> suffix
        {text, {text, size}}
      end)

    texts
  end

  defp counted(bytes, n) do
    {lengths, rest} = Runs.deltas(bytes, n)
    if length(lengths) != n, do: fail("another number of values than the page says")
    {lengths, rest}
  end

  @doc """
  The bytes of `n` values in their order, out of the first bytes of all, the second ones ...

      iex> Situ.Bridge.Parquet.Deltas.streams(<<1, 2, 3, 4, 5, 6>>, 2, 3)
      <<1, 4, 2, 5, 3, 6>>
  """
  @spec streams(binary(), pos_integer(), non_neg_integer()) :: binary()
  def streams(bytes, width, n) when byte_size(bytes) >= width * n do
    for(i <- 0..(width - 1)//1, do: bytes |> binary_part(i * n, n) |> :binary.bin_to_list())
    |> Enum.zip_with(&:binary.list_to_bin/1)
    |> IO.iodata_to_binary()
  end

  def streams(_bytes, _width, _n), do: fail("a page with too few values")

  defp fail(why), do: throw({:not_parquet, why})
end

defmodule Situ.Bridge.Parquet.Runs do
  @moduledoc false
  # Small numbers as runs of one number and groups of eight packed ones (Parquet's RLE/bit-packing hybrid), and numbers
  # as packed differences (DELTA_BINARY_PACKED). Pure. Throws `{:not_parquet, why}`.
  import Situ.Bits, only: [known: 1]
  import Bitwise
  alias Situ.Bridge.Parquet.Thrift

  @doc """
  `count` numbers of `width` bits.

      iex> Situ.Bridge.Parquet.Runs.read(<<6, 1, 3, 0b10001000>>, 1, 8)
      [1, 1, 1, 0, 0, 0, 1, 0]
  """
  @spec read(binary(), 0..32, non_neg_integer()) :: [non_neg_integer()]
  def read(_bytes, 0, count), do: List.duplicate(0, count)

  def read(bytes, width, count) when width <= 32,
    do: bytes |> runs(width, count, []) |> Enum.concat()

  def read(_bytes, width, _count), do: fail("numbers of #{width} bits")

  defp runs(_bytes, _width, left, found) when left <= 0, do: Enum.reverse(found)

  defp runs(bytes, width, left, found) do
    case Thrift.unsigned(bytes) do
      {head, rest} when (head &&& 1) == 1 ->
        n = min((head >>> 1) * 8, left)
        size = (head >>> 1) * width
        {packed, rest} = take(rest, size)
        runs(rest, width, left - n, [packed(packed, width, n) | found])

      {head, rest} ->
        n = min(head >>> 1, left)
        if n == 0, do: fail("a run of nothing")
        {value, rest} = take(rest, div(width + 7, 8))

        runs(rest, width, left - n, [
          List.duplicate(:binary.decode_unsigned(value, :little), n) | found
        ])
    end
  end

  # Writers may leave out the zeros at the end of the last group.
  defp take(bytes, n) when byte_size(bytes) >= n do
    <<part::binary-known(n), rest::binary>> = bytes
    {part, rest}
  end

  defp take(_bytes, n), do: fail("it lacks #{n} bytes")

  # The lowest bits first: as one number, taken from its end.
  defp packed(_bytes, 0, count), do: List.duplicate(0, count)

  defp packed(bytes, width, count) do
    for group <- groups(bytes, width), n = :binary.decode_unsigned(group, :little), i <- 0..7 do
      n >>> (i * width) &&& (1 <<< width) - 1
    end
    |> Enum.take(count)
  end

  defp groups(bytes, width), do: for(<<group::binary-known(width) <- bytes>>, do: group)

  @doc "Numbers of 64 bits as packed differences, and what follows them."
  @spec deltas(binary(), most :: non_neg_integer()) :: {[integer()], binary()}
  def deltas(bytes, most) do
    {block, rest} = Thrift.unsigned(bytes)
    {minis, rest} = Thrift.unsigned(rest)
    {count, rest} = Thrift.unsigned(rest)
    {first, rest} = signed(rest)

    if minis == 0 or block == 0 or rem(block, minis * 8) != 0 or block > 1_048_576 or
         count > most,
       do: fail("packed differences that are none")

    if count == 0,
      do: {[], rest},
      else: blocks(rest, div(block, minis), minis, count - 1, [first])
  end

  defp blocks(rest, _size, _minis, left, found) when left <= 0,
    do: {Enum.reverse(found), rest}

  defp blocks(rest, size, minis, left, found) do
    {least, rest} = signed(rest)
    {widths, rest} = take(rest, minis)
    {rest, left, found} = minis(rest, :binary.bin_to_list(widths), size, least, left, found)
    blocks(rest, size, minis, left, found)
  end

  defp minis(rest, [], _size, _least, left, found), do: {rest, left, found}
  defp minis(rest, _widths, _size, _least, left, found) when left <= 0, do: {rest, left, found}

  defp minis(rest, [width | widths], size, least, left, found) do
    if width > 64, do: fail("numbers of #{width} bits")
    {bytes, rest} = take(rest, div(size * width, 8))
    n = min(size, left)

    found =
      bytes
      |> packed(width, n)
      |> Enum.reduce(found, fn delta, [last | _] = found ->
        [wrapped(last + least + delta) | found]
      end)

    minis(rest, widths, size, least, left - n, found)
  end

  defp wrapped(n) do
    <<n::signed-64>> = <<n::64>>
    n
  end

  defp signed(bytes) do
    {n, rest} = Thrift.unsigned(bytes)
    {bxor(n >>> 1, -(n &&& 1)), rest}
  end

  defp fail(why), do: throw({:not_parquet, why})
end

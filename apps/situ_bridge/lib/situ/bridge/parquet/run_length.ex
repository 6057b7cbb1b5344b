defmodule Situ.Bridge.Parquet.RunLength do
  @moduledoc false
  # Decodes small numbers stored as runs of equal numbers and groups of eight packed numbers (Parquet's
  # RLE/bit-packing hybrid), a few at a time, and numbers stored as packed deltas (DELTA_BINARY_PACKED). Pure. Throws
  # `{:not_parquet, why}`.
  import Situ.BinarySize, only: [pinned_size: 1]
  import Bitwise
  alias Situ.Bridge.Parquet.Thrift

  # Deltas of zero bits take no bytes, so a small page could claim a huge number of them.
  @most_deltas 20_000_000

  @enforce_keys [:bytes, :width]
  defstruct [:bytes, :width, run: nil]

  @typedoc "The current run: a number and its remaining count, or packed groups and the numbers unpacked so far."
  @type run ::
          nil
          | {:same, non_neg_integer(), pos_integer()}
          | {:packed, binary(), [non_neg_integer()]}
  @type t :: %__MODULE__{bytes: binary(), width: 0..32, run: run()}

  @doc "Starts reading numbers of `width` bits at the beginning of `bytes`."
  @spec from_bytes(binary(), non_neg_integer()) :: t()
  def from_bytes(bytes, width) when width <= 32, do: %__MODULE__{bytes: bytes, width: width}

  def from_bytes(_bytes, width),
    do: throw_malformed("numbers have an invalid width of #{width} bits")

  @doc """
  Takes the next `count` numbers.

      iex> alias Situ.Bridge.Parquet.RunLength
      iex> {first, runs} = <<6, 1, 3, 0b10001000>> |> RunLength.from_bytes(1) |> RunLength.take_numbers(5)
      iex> {rest, _runs} = RunLength.take_numbers(runs, 3)
      iex> {first, rest}
      {[1, 1, 1, 0, 0], [0, 1, 0]}
  """
  @spec take_numbers(t(), non_neg_integer()) :: {[non_neg_integer()], t()}
  def take_numbers(%{width: 0} = runs, count), do: {List.duplicate(0, count), runs}
  def take_numbers(runs, count), do: collect_numbers(runs, count, [])

  defp collect_numbers(runs, 0, found), do: {found |> Enum.reverse() |> Enum.concat(), runs}

  defp collect_numbers(%{run: nil} = runs, count, found),
    do: runs |> next_run() |> collect_numbers(count, found)

  defp collect_numbers(%{run: {:same, value, left}} = runs, count, found) do
    n = min(left, count)
    run = if left > n, do: {:same, value, left - n}
    collect_numbers(%{runs | run: run}, count - n, [List.duplicate(value, n) | found])
  end

  defp collect_numbers(%{run: {:packed, bytes, held}, width: width} = runs, count, found) do
    missing = max(count - length(held), 0)
    size = width * min(div(missing + 7, 8), div(byte_size(bytes), width))
    <<groups::binary-pinned_size(size), rest::binary>> = bytes
    {taken, held} = Enum.split(held ++ unpack_groups(groups, width), count)
    run = if rest != "" or held != [], do: {:packed, rest, held}
    collect_numbers(%{runs | run: run}, count - length(taken), [taken | found])
  end

  defp next_run(%{bytes: bytes, width: width} = runs) do
    case Thrift.decode_varint(bytes) do
      {head, rest} when (head &&& 1) == 1 ->
        {packed, rest} = split_bytes(rest, (head >>> 1) * width)
        %{runs | bytes: rest, run: if(packed != "", do: {:packed, packed, []})}

      {0, _rest} ->
        throw_malformed("a run is empty")

      {head, rest} ->
        {value, rest} = split_bytes(rest, div(width + 7, 8))
        %{runs | bytes: rest, run: {:same, :binary.decode_unsigned(value, :little), head >>> 1}}
    end
  end

  defp split_bytes(bytes, n) when byte_size(bytes) >= n do
    <<part::binary-pinned_size(n), rest::binary>> = bytes
    {part, rest}
  end

  defp split_bytes(_bytes, n), do: throw_malformed("#{n} bytes are missing")

  # The lowest bits come first, so a group is decoded as one little-endian number.
  defp unpack_groups(bytes, width) do
    for <<group::binary-pinned_size(width) <- bytes>>,
        n = :binary.decode_unsigned(group, :little),
        i <- 0..7,
        do: n >>> (i * width) &&& (1 <<< width) - 1
  end

  @doc """
  Decodes at most `most` numbers of `bits` bits from packed deltas; also returns the bytes after them.

  Sums wrap at the width of the column: a writer of `int32` may store the difference from -2147483648 to 2147483647 as
  -1.

      iex> bytes = <<128, 1, 4, 2, 254, 255, 255, 255, 15, 2, 0, 0, 0, 0>>
      iex> Situ.Bridge.Parquet.RunLength.decode_deltas(bytes, 2, 32)
      {[2147483647, -2147483648], ""}
  """
  @spec decode_deltas(binary(), most :: non_neg_integer(), 32 | 64) :: {[integer()], binary()}
  def decode_deltas(bytes, most, bits) do
    {block, rest} = Thrift.decode_varint(bytes)
    {minis, rest} = Thrift.decode_varint(rest)
    {count, rest} = Thrift.decode_varint(rest)
    {first, rest} = decode_zigzag(rest)

    if minis == 0 or block == 0 or rem(block, minis * 8) != 0 or block > 1_048_576 or
         count > min(most, @most_deltas),
       do: throw_malformed("a block of packed deltas is malformed")

    if count == 0,
      do: {[], rest},
      else:
        decode_blocks(rest, {div(block, minis), minis, bits}, count - 1, [
          wrap_integer(first, bits)
        ])
  end

  defp decode_blocks(rest, _shape, left, found) when left <= 0, do: {Enum.reverse(found), rest}

  defp decode_blocks(rest, {size, minis, bits} = shape, left, found) do
    {least, rest} = decode_zigzag(rest)
    {widths, rest} = split_bytes(rest, minis)
    widths = :binary.bin_to_list(widths)
    {rest, left, found} = decode_miniblocks(rest, widths, {size, least, bits}, left, found)
    decode_blocks(rest, shape, left, found)
  end

  defp decode_miniblocks(rest, [], _block, left, found), do: {rest, left, found}

  defp decode_miniblocks(rest, _widths, _block, left, found) when left <= 0,
    do: {rest, left, found}

  defp decode_miniblocks(rest, [width | widths], {size, least, bits} = block, left, found) do
    if width > 64, do: throw_malformed("deltas have an invalid width of #{width} bits")
    {bytes, rest} = split_bytes(rest, div(size * width, 8))
    n = min(size, left)

    deltas =
      if width == 0, do: List.duplicate(0, n), else: bytes |> unpack_groups(width) |> Enum.take(n)

    found =
      Enum.reduce(deltas, found, fn delta, [last | _] = found ->
        [wrap_integer(last + least + delta, bits) | found]
      end)

    decode_miniblocks(rest, widths, block, left - n, found)
  end

  defp wrap_integer(n, 32) do
    <<n::signed-32>> = <<n::32>>
    n
  end

  defp wrap_integer(n, 64) do
    <<n::signed-64>> = <<n::64>>
    n
  end

  defp decode_zigzag(bytes) do
    {n, rest} = Thrift.decode_varint(bytes)
    {bxor(n >>> 1, -(n &&& 1)), rest}
  end

  defp throw_malformed(why), do: throw({:not_parquet, why})
end

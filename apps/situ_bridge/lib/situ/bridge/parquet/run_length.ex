defmodule Situ.Bridge.Parquet.RunLength do
  @moduledoc false
  # Decodes small numbers stored as runs of equal numbers and groups of eight packed numbers (Parquet's
  # RLE/bit-packing hybrid), a few at a time, and numbers stored as packed deltas (DELTA_BINARY_PACKED). Pure. Throws
  # `{:not_parquet, why}`.
  import Situ.BinarySize, only: [pinned_size: 1]
  import Bitwise
  alias Situ.Bridge.Parquet.Thrift

  # Deltas of zero bits take no bytes, so a small page could claim a huge number of them.
  @max_deltas 20_000_000

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

  defp collect_numbers(runs, 0, acc), do: {acc |> Enum.reverse() |> Enum.concat(), runs}

  defp collect_numbers(%{run: nil} = runs, count, acc),
    do: runs |> next_run() |> collect_numbers(count, acc)

  defp collect_numbers(%{run: {:same, value, remaining}} = runs, count, acc) do
    n = min(remaining, count)
    run = if remaining > n, do: {:same, value, remaining - n}
    collect_numbers(%{runs | run: run}, count - n, [List.duplicate(value, n) | acc])
  end

  defp collect_numbers(%{run: {:packed, bytes, unpacked}, width: width} = runs, count, acc) do
    missing = max(count - length(unpacked), 0)
    size = width * min(div(missing + 7, 8), div(byte_size(bytes), width))
    <<groups::binary-pinned_size(size), rest::binary>> = bytes
    {numbers, unpacked} = Enum.split(unpacked ++ unpack_groups(groups, width), count)
    run = if rest != "" or unpacked != [], do: {:packed, rest, unpacked}
    collect_numbers(%{runs | run: run}, count - length(numbers), [numbers | acc])
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
  Decodes at most `max` numbers of `bits` bits from packed deltas; also returns the bytes after them.

  Sums wrap at the width of the column: a writer of `int32` may store the difference from -2147483648 to 2147483647 as
  -1.

      iex> bytes = <<128, 1, 4, 2, 254, 255, 255, 255, 15, 2, 0, 0, 0, 0>>
      iex> Situ.Bridge.Parquet.RunLength.decode_deltas(bytes, 2, 32)
      {[2147483647, -2147483648], ""}
  """
  @spec decode_deltas(binary(), max :: non_neg_integer(), 32 | 64) :: {[integer()], binary()}
  def decode_deltas(bytes, max, bits) do
    {block, rest} = Thrift.decode_varint(bytes)
    {miniblocks, rest} = Thrift.decode_varint(rest)
    {count, rest} = Thrift.decode_varint(rest)
    {first, rest} = decode_zigzag(rest)

    if miniblocks == 0 or block == 0 or rem(block, miniblocks * 8) != 0 or block > 1_048_576 or
         count > min(max, @max_deltas),
       do: throw_malformed("a block of packed deltas is malformed")

    if count == 0,
      do: {[], rest},
      else:
        decode_blocks(rest, {div(block, miniblocks), miniblocks, bits}, count - 1, [
          wrap_integer(first, bits)
        ])
  end

  defp decode_blocks(rest, _shape, remaining, acc) when remaining <= 0,
    do: {Enum.reverse(acc), rest}

  defp decode_blocks(rest, {size, miniblocks, bits} = shape, remaining, acc) do
    {min_delta, rest} = decode_zigzag(rest)
    {widths, rest} = split_bytes(rest, miniblocks)
    widths = :binary.bin_to_list(widths)

    {rest, remaining, acc} =
      decode_miniblocks(rest, widths, {size, min_delta, bits}, remaining, acc)

    decode_blocks(rest, shape, remaining, acc)
  end

  defp decode_miniblocks(rest, [], _block, remaining, acc), do: {rest, remaining, acc}

  defp decode_miniblocks(rest, _widths, _block, remaining, acc) when remaining <= 0,
    do: {rest, remaining, acc}

  defp decode_miniblocks(rest, [width | widths], {size, min_delta, bits} = block, remaining, acc) do
    if width > 64, do: throw_malformed("deltas have an invalid width of #{width} bits")
    {bytes, rest} = split_bytes(rest, div(size * width, 8))
    n = min(size, remaining)

    deltas =
      if width == 0, do: List.duplicate(0, n), else: bytes |> unpack_groups(width) |> Enum.take(n)

    acc =
      Enum.reduce(deltas, acc, fn delta, [last | _] = acc ->
        [wrap_integer(last + min_delta + delta, bits) | acc]
      end)

    decode_miniblocks(rest, widths, block, remaining - n, acc)
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

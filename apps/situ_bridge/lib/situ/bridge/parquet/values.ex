defmodule Situ.Bridge.Parquet.Values do
  @moduledoc false
  # Decodes the values of one page, a few at a time: a page of one megabyte has 131,072 floats, and each float takes
  # four times as much memory as an Elixir term. Pure. Throws `{:not_parquet, why}`.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Columnar.Column
  alias Situ.Bridge.Parquet.{ByteArrays, Leaf, RunLength}
  alias Situ.Number

  # The number of bytes of a value, by Parquet's physical type.
  @widths %{1 => 4, 2 => 8, 3 => 12, 4 => 4, 5 => 8}
  @encodings %{4 => "BIT_PACKED"}

  @typedoc """
  The rest of a page: plain bytes; packed booleans, and the booleans unpacked so far; dictionary indexes; runs of
  booleans; separated bytes, and the number of values taken; or decoded values.
  """
  @type t ::
          {:plain, Leaf.t(), binary()}
          | {:bits, binary(), [boolean()]}
          | {:entries, RunLength.t(), dictionary()}
          | {:booleans, RunLength.t()}
          | {:apart, Leaf.t(), pos_integer(), binary(), non_neg_integer()}
          | {:decoded, [term()]}

  @typedoc """
  The entries of a dictionary. Entries of a fixed size stay encoded and are decoded on demand, because a dictionary
  may have many more entries than the requested rows. Other entries are decoded.
  """
  @type dictionary ::
          {:packed, Leaf.t(), width :: pos_integer(), binary()} | {:decoded, tuple()}

  @doc "Builds a dictionary of `n` entries."
  @spec start_dictionary(Leaf.t(), binary(), non_neg_integer()) :: dictionary()
  def start_dictionary(%{type: type} = leaf, bytes, n) when type in 1..5 do
    width = @widths[type]
    {entries, _rest} = split_bytes(bytes, n * width)
    {:packed, leaf, width, entries}
  end

  def start_dictionary(leaf, bytes, n) do
    {values, _rest} = decode_plain(leaf, bytes, n)
    {:decoded, List.to_tuple(values)}
  end

  defp dictionary_entry({:packed, leaf, width, bytes}, index)
       when (index + 1) * width <= byte_size(bytes) do
    {[value], ""} = decode_plain(leaf, binary_part(bytes, index * width, width), 1)
    value
  end

  defp dictionary_entry({:decoded, values}, index) when index < tuple_size(values),
    do: elem(values, index)

  defp dictionary_entry(_dictionary, _position),
    do: throw_malformed("an index is outside the dictionary")

  @doc "Starts decoding the values of a page with at most `n` rows."
  @spec start_decoding(
          Leaf.t(),
          encoding :: integer(),
          binary(),
          n :: pos_integer(),
          dictionary() | nil
        ) ::
          t()
  def start_decoding(%{type: 0}, 0, bytes, _n, _dictionary), do: {:bits, bytes, []}
  def start_decoding(leaf, 0, bytes, _n, _dictionary), do: {:plain, leaf, bytes}

  def start_decoding(_leaf, encoding, "", _n, _dictionary) when encoding in [2, 8],
    do: {:decoded, []}

  def start_decoding(_leaf, encoding, <<width, bytes::binary>>, _n, dictionary)
      when encoding in [2, 8] and dictionary != nil,
      do: {:entries, RunLength.from_bytes(bytes, width), dictionary}

  def start_decoding(
        %{type: 0},
        3,
        <<size::little-32, bytes::binary-size(size), _::binary>>,
        _n,
        _
      ),
      do: {:booleans, RunLength.from_bytes(bytes, 1)}

  def start_decoding(%{type: type} = leaf, 5, bytes, n, _dictionary) when type in [1, 2] do
    {values, _rest} = RunLength.decode_deltas(bytes, n, if(type == 1, do: 32, else: 64))
    {:decoded, Enum.map(values, &convert_number(&1, leaf.meaning))}
  end

  def start_decoding(%{type: 6} = leaf, 6, bytes, n, _dictionary),
    do:
      {:decoded,
       bytes |> ByteArrays.decode_texts(n) |> Enum.map(&Leaf.convert_bytes(&1, leaf.meaning))}

  def start_decoding(%{type: type} = leaf, 7, bytes, n, _dictionary) when type in [6, 7],
    do:
      {:decoded,
       bytes
       |> ByteArrays.decode_prefixed_texts(n)
       |> Enum.map(&Leaf.convert_bytes(&1, leaf.meaning))}

  def start_decoding(leaf, 9, bytes, _n, _dictionary) do
    width = value_width(leaf)

    if rem(byte_size(bytes), width) != 0,
      do: throw_malformed("a byte stream does not have whole values")

    {:apart, leaf, width, bytes, 0}
  end

  def start_decoding(_leaf, encoding, _bytes, _n, _dictionary) do
    name = @encodings[encoding] || inspect(encoding)
    throw_malformed("the encoding #{name} is not supported")
  end

  defp value_width(%{type: type}) when type in [1, 4], do: 4
  defp value_width(%{type: type}) when type in [2, 5], do: 8
  defp value_width(%{type: 7, length: length}) when length > 0, do: length
  defp value_width(_leaf), do: throw_malformed("a byte stream has values without a size")

  @doc "Takes the next `n` values."
  @spec take_next(t(), non_neg_integer()) :: {[term()], t()}
  def take_next(values, 0), do: {[], values}

  def take_next({:plain, leaf, bytes}, n) do
    {values, rest} = decode_plain(leaf, bytes, n)
    {values, {:plain, leaf, rest}}
  end

  # A byte holds eight booleans, so some may be left over.
  def take_next({:bits, bytes, booleans}, n) do
    {packed, rest} = split_bytes(bytes, div(max(n - length(booleans), 0) + 7, 8))
    {values, booleans} = Enum.split(booleans ++ Column.unpack_bits(packed), n)
    {values, {:bits, rest, booleans}}
  end

  def take_next({:entries, runs, dictionary}, n) do
    {indexes, runs} = RunLength.take_numbers(runs, n)

    values = for index <- indexes, do: dictionary_entry(dictionary, index)
    {values, {:entries, runs, dictionary}}
  end

  def take_next({:booleans, runs}, n) do
    {bits, runs} = RunLength.take_numbers(runs, n)
    {Enum.map(bits, &(&1 == 1)), {:booleans, runs}}
  end

  def take_next({:apart, leaf, width, bytes, from}, n) do
    {values, ""} = decode_plain(leaf, ByteArrays.join_bytes(bytes, width, from, n), n)
    {values, {:apart, leaf, width, bytes, from + n}}
  end

  def take_next({:decoded, values}, n) do
    {head, values} = Enum.split(values, n)
    if length(head) < n, do: throw_malformed("a page has fewer values than it declares")
    {head, {:decoded, values}}
  end

  @doc "Returns whether values are left over. This is possible only for encodings that store their own count of values."
  @spec left_over?(t()) :: boolean()
  def left_over?(values), do: match?({:decoded, [_ | _]}, values)

  @doc "Decodes the first `n` values of the encoding PLAIN; also returns the remaining bytes."
  @spec decode_plain(Leaf.t(), binary(), non_neg_integer()) :: {[term()], binary()}
  def decode_plain(%{type: 0}, bytes, n) do
    {packed, rest} = split_bytes(bytes, div(n + 7, 8))
    {packed |> Column.unpack_bits() |> Enum.take(n), rest}
  end

  def decode_plain(%{type: 6, meaning: meaning}, bytes, n),
    do: decode_texts(bytes, n, meaning, [])

  def decode_plain(%{type: 7, length: length, meaning: meaning}, bytes, n) when length > 0 do
    {packed, rest} = split_bytes(bytes, n * length)

    values =
      for <<x::binary-pinned_size(length) <- packed>>,
        do: x |> :binary.copy() |> Leaf.convert_bytes(meaning)

    {values, rest}
  end

  def decode_plain(%{type: type, meaning: meaning}, bytes, n) when type in 1..5 do
    {packed, rest} = split_bytes(bytes, n * @widths[type])
    {decode_numbers(type, packed, meaning), rest}
  end

  def decode_plain(_leaf, _bytes, _n), do: throw_malformed("fixed-size values have no size")

  defp decode_numbers(1, packed, meaning),
    do: for(<<x::little-signed-32 <- packed>>, do: convert_number(x, meaning))

  defp decode_numbers(2, packed, meaning),
    do: for(<<x::little-signed-64 <- packed>>, do: convert_number(x, meaning))

  defp decode_numbers(3, packed, _as) do
    for <<ns::little-64, day::little-32 <- packed>>,
      do: (day - 2_440_588) * 86_400_000_000_000 + ns
  end

  defp decode_numbers(4, packed, _as), do: Number.decode_floats(packed, 4)
  defp decode_numbers(5, packed, _as), do: Number.decode_floats(packed, 8)

  defp split_bytes(bytes, n) when n in 0..byte_size(bytes)//1 do
    <<part::binary-pinned_size(n), rest::binary>> = bytes
    {part, rest}
  end

  defp split_bytes(_bytes, _n), do: throw_malformed("a page has too few values")

  defp decode_texts(bytes, 0, _kind, acc), do: {Enum.reverse(acc), bytes}

  defp decode_texts(<<n::little-32, text::binary-size(n), rest::binary>>, count, kind, acc) do
    text = text |> :binary.copy() |> Leaf.convert_bytes(kind)
    decode_texts(rest, count - 1, kind, [text | acc])
  end

  defp decode_texts(_short, _count, _kind, _acc), do: throw_malformed("a string is truncated")

  defp convert_number(n, nil), do: n
  defp convert_number(n, {:times, factor}), do: n * factor
  defp convert_number(n, {:scale, scale}), do: n / Integer.pow(10, scale)
  defp convert_number(n, {:unsigned, bits}) when n < 0, do: n + Integer.pow(2, bits)
  defp convert_number(n, {:unsigned, _}), do: n

  defp throw_malformed(why), do: throw({:not_parquet, why})
end

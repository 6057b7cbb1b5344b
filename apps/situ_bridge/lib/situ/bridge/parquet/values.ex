defmodule Situ.Bridge.Parquet.Values do
  @moduledoc false
  # The values of one page, decoded a few at a time: a page of one megabyte has 131,072 floats, and each is four times
  # as large as a term. Pure. Throws `{:not_parquet, why}`.
  import Situ.Bits, only: [known: 1]
  alias Situ.Bridge.Parquet.{Deltas, Leaf, Runs}

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
          | {:entries, Runs.t(), dictionary()}
          | {:booleans, Runs.t()}
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

  defp entry({:packed, leaf, width, bytes}, place) when (place + 1) * width <= byte_size(bytes) do
    {[value], ""} = decode_plain(leaf, binary_part(bytes, place * width, width), 1)
    value
  end

  defp entry({:decoded, values}, place) when place < tuple_size(values), do: elem(values, place)
  defp entry(_dictionary, _place), do: fail("an index is outside the dictionary")

  @doc "Starts decoding the values of a page with at most `n` rows."
  @spec start(Leaf.t(), encoding :: integer(), binary(), n :: pos_integer(), dictionary() | nil) ::
          t()
  def start(%{type: 0}, 0, bytes, _n, _dictionary), do: {:bits, bytes, []}
  def start(leaf, 0, bytes, _n, _dictionary), do: {:plain, leaf, bytes}
  def start(_leaf, encoding, "", _n, _dictionary) when encoding in [2, 8], do: {:decoded, []}

  def start(_leaf, encoding, <<width, bytes::binary>>, _n, dictionary)
      when encoding in [2, 8] and dictionary != nil,
      do: {:entries, Runs.start(bytes, width), dictionary}

  def start(%{type: 0}, 3, <<size::little-32, bytes::binary-size(size), _::binary>>, _n, _),
    do: {:booleans, Runs.start(bytes, 1)}

  def start(%{type: type} = leaf, 5, bytes, n, _dictionary) when type in [1, 2] do
    {values, _rest} = Runs.decode_deltas(bytes, n, if(type == 1, do: 32, else: 64))
    {:decoded, Enum.map(values, &convert(&1, leaf.as))}
  end

  def start(%{type: 6} = leaf, 6, bytes, n, _dictionary),
    do: {:decoded, bytes |> Deltas.decode_texts(n) |> Enum.map(&Leaf.meant(&1, leaf.as))}

  def start(%{type: type} = leaf, 7, bytes, n, _dictionary) when type in [6, 7],
    do: {:decoded, bytes |> Deltas.decode_prefixed_texts(n) |> Enum.map(&Leaf.meant(&1, leaf.as))}

  def start(leaf, 9, bytes, _n, _dictionary) do
    width = width(leaf)
    if rem(byte_size(bytes), width) != 0, do: fail("a byte stream does not have whole values")
    {:apart, leaf, width, bytes, 0}
  end

  def start(_leaf, encoding, _bytes, _n, _dictionary) do
    name = @encodings[encoding] || inspect(encoding)
    fail("the encoding #{name} is not supported")
  end

  defp width(%{type: type}) when type in [1, 4], do: 4
  defp width(%{type: type}) when type in [2, 5], do: 8
  defp width(%{type: 7, length: length}) when length > 0, do: length
  defp width(_leaf), do: fail("a byte stream has values without a size")

  @doc "Takes the next `n` values."
  @spec take(t(), non_neg_integer()) :: {[term()], t()}
  def take(values, 0), do: {[], values}

  def take({:plain, leaf, bytes}, n) do
    {values, rest} = decode_plain(leaf, bytes, n)
    {values, {:plain, leaf, rest}}
  end

  # A byte holds eight booleans, so some may be left over.
  def take({:bits, bytes, held}, n) do
    {packed, rest} = split_bytes(bytes, div(max(n - length(held), 0) + 7, 8))
    {values, held} = Enum.split(held ++ bits(packed), n)
    {values, {:bits, rest, held}}
  end

  def take({:entries, runs, dictionary}, n) do
    {places, runs} = Runs.take(runs, n)

    values = for place <- places, do: entry(dictionary, place)
    {values, {:entries, runs, dictionary}}
  end

  def take({:booleans, runs}, n) do
    {bits, runs} = Runs.take(runs, n)
    {Enum.map(bits, &(&1 == 1)), {:booleans, runs}}
  end

  def take({:apart, leaf, width, bytes, from}, n) do
    {values, ""} = decode_plain(leaf, Deltas.join_bytes(bytes, width, from, n), n)
    {values, {:apart, leaf, width, bytes, from + n}}
  end

  def take({:decoded, values}, n) do
    {taken, values} = Enum.split(values, n)
    if length(taken) < n, do: fail("a page has fewer values than it declares")
    {taken, {:decoded, values}}
  end

  @doc "Returns whether values are left over. Only encodings with their own count of values can have some."
  @spec left_over?(t()) :: boolean()
  def left_over?(values), do: match?({:decoded, [_ | _]}, values)

  @doc "Decodes the first `n` values of the encoding PLAIN; also returns the remaining bytes."
  @spec decode_plain(Leaf.t(), binary(), non_neg_integer()) :: {[term()], binary()}
  def decode_plain(%{type: 0}, bytes, n) do
    {packed, rest} = split_bytes(bytes, div(n + 7, 8))
    {packed |> bits() |> Enum.take(n), rest}
  end

  def decode_plain(%{type: 6, as: as}, bytes, n), do: texts(bytes, n, as, [])

  def decode_plain(%{type: 7, length: length, as: as}, bytes, n) when length > 0 do
    {packed, rest} = split_bytes(bytes, n * length)

    values = for <<x::binary-known(length) <- packed>>, do: x |> :binary.copy() |> Leaf.meant(as)

    {values, rest}
  end

  def decode_plain(%{type: type, as: as}, bytes, n) when type in 1..5 do
    {packed, rest} = split_bytes(bytes, n * @widths[type])
    {numbers(type, packed, as), rest}
  end

  def decode_plain(_leaf, _bytes, _n), do: fail("fixed-size values have no size")

  defp numbers(1, packed, as), do: for(<<x::little-signed-32 <- packed>>, do: convert(x, as))
  defp numbers(2, packed, as), do: for(<<x::little-signed-64 <- packed>>, do: convert(x, as))

  defp numbers(3, packed, _as) do
    for <<ns::little-64, day::little-32 <- packed>>,
      do: (day - 2_440_588) * 86_400_000_000_000 + ns
  end

  defp numbers(4, packed, _as), do: for(<<x::binary-4 <- packed>>, do: float(x))
  defp numbers(5, packed, _as), do: for(<<x::binary-8 <- packed>>, do: float(x))

  defp bits(packed) do
    for <<a::1, b::1, c::1, d::1, e::1, f::1, g::1, h::1 <- packed>>,
        bit <- [h, g, f, e, d, c, b, a],
        do: bit == 1
  end

  defp split_bytes(bytes, n) when n in 0..byte_size(bytes)//1 do
    <<part::binary-known(n), rest::binary>> = bytes
    {part, rest}
  end

  defp split_bytes(_bytes, _n), do: fail("a page has too few values")

  defp texts(bytes, 0, _as, found), do: {Enum.reverse(found), bytes}

  defp texts(<<n::little-32, text::binary-size(n), rest::binary>>, left, as, found),
    do: texts(rest, left - 1, as, [text |> :binary.copy() |> Leaf.meant(as) | found])

  defp texts(_short, _left, _as, _found), do: fail("a string is truncated")

  defp float(<<x::little-float-64>>), do: x
  defp float(<<x::little-float-32>>), do: x
  defp float(<<0::48, 0xF0, 0x7F>>), do: :infinity
  defp float(<<0::48, 0xF0, 0xFF>>), do: :neg_infinity
  defp float(<<0, 0, 0x80, 0x7F>>), do: :infinity
  defp float(<<0, 0, 0x80, 0xFF>>), do: :neg_infinity
  defp float(_), do: :nan

  defp convert(n, nil), do: n
  defp convert(n, {:times, factor}), do: n * factor
  defp convert(n, {:scale, scale}), do: n / Integer.pow(10, scale)
  defp convert(n, {:unsigned, bits}) when n < 0, do: n + Integer.pow(2, bits)
  defp convert(n, {:unsigned, _}), do: n

  defp fail(why), do: throw({:not_parquet, why})
end

defmodule Situ.Bridge.Arrow.Values do
  @moduledoc false
  # The values of one column in a batch, from its buffers. Pure, but for what unpacks. Throws `{:not_arrow, why}`.
  import Situ.Bits, only: [known: 1]
  alias Situ.Bridge.Native

  @most 1_073_741_824
  @most_missing 10_000_000
  @codecs %{0 => "lz4", 1 => "zstd"}

  @doc "A buffer as it was before it was packed."
  @spec unpack(binary(), codec :: integer() | nil) :: binary()
  def unpack(bytes, nil), do: bytes
  def unpack("", _codec), do: ""
  def unpack(<<-1::little-signed-64, bytes::binary>>, _codec), do: bytes

  def unpack(<<size::little-signed-64, bytes::binary>>, codec)
      when size in 0..@most and is_map_key(@codecs, codec) do
    case Native.unpack(@codecs[codec], bytes, size) do
      {:ok, unpacked} when byte_size(unpacked) == size -> unpacked
      {:ok, _} -> fail("a buffer unpacks to another size")
      {:error, why} -> fail("a buffer that cannot be unpacked: #{inspect(why)}")
    end
  end

  def unpack(_bytes, _codec), do: fail("a buffer packed in a way that is not known")

  @doc """
  All values of so many rows, `nil` where one is missing; `inner` are the names and values of the columns in it.

      iex> Situ.Bridge.Arrow.Values.read({:lists, 2}, ["\\x01"], 2, [{"item", [1, 2, 3, 4]}])
      [[1, 2], nil]
  """
  @spec read(term(), [binary()], rows :: non_neg_integer(), [{String.t(), [term()]}]) :: [term()]
  def read(:null, _buffers, n, _inner) when n in 0..@most_missing, do: List.duplicate(nil, n)

  def read(type, [presence | buffers], n, inner) do
    values = nested(type, buffers, n, inner)
    if presence == "", do: values, else: present(bits(presence, n), values)
  end

  def read(_type, _buffers, _n, _inner), do: fail("a column without its buffers")

  defp nested(:struct, [], n, inner) do
    {names, columns} = Enum.unzip(inner)

    if Enum.any?(columns, &(length(&1) != n)),
      do: fail("structs whose members have another number of rows")

    Enum.zip_with(columns, &(names |> Enum.zip(&1) |> Map.new()))
  end

  defp nested({:lists, size}, [], n, [{_, items}]) do
    if length(items) < n * size, do: fail("lists of fewer items than they have")
    items |> Enum.take(n * size) |> Enum.chunk_every(size)
  end

  defp nested({:list, bits}, [ends], n, [{_, items}]), do: lists(ends, bits, n, items)

  # Pairs are structs of two members.
  defp nested({:map, [key, value]}, [ends], n, [{_, pairs}]) do
    for pairs <- lists(ends, 32, n, pairs),
        do: for(%{^key => name, ^value => held} <- pairs, into: %{}, do: {name, held})
  end

  defp nested(type, buffers, n, _inner), do: values(type, buffers, n)

  defp lists(_ends, _bits, 0, _items), do: []

  defp lists(ends, bits, n, items) do
    [first | ends] = for <<x::little-signed-known(bits) <- cut(ends, n + 1, bits)>>, do: x
    if first < 0, do: fail("a list that begins before its items")
    {lists, _} = Enum.map_reduce(ends, {first, Enum.drop(items, first)}, &list/2)
    lists
  end

  defp list(ends, {at, items}) do
    if ends < at, do: fail("a list that ends before it begins")
    {list, rest} = Enum.split(items, ends - at)
    if length(list) != ends - at, do: fail("a list that goes beyond its items")
    {list, {ends, rest}}
  end

  defp present([true | bits], [value | values]), do: [value | present(bits, values)]
  defp present([false | bits], [_ | values]), do: [nil | present(bits, values)]
  defp present([], []), do: []

  defp values(:boolean, [bytes], n), do: bits(bytes, n)

  defp values({:integer, bits, true}, [bytes], n),
    do: for(<<x::little-signed-known(bits) <- cut(bytes, n, bits)>>, do: x)

  defp values({:integer, bits, false}, [bytes], n),
    do: for(<<x::little-known(bits) <- cut(bytes, n, bits)>>, do: x)

  defp values({:times, bits, factor, _}, [bytes], n),
    do: for(<<x::little-signed-known(bits) <- cut(bytes, n, bits)>>, do: x * factor)

  defp values({:decimal, bits, scale}, [bytes], n) do
    unit = Integer.pow(10, scale)
    for <<x::little-signed-known(bits) <- cut(bytes, n, bits)>>, do: x / unit
  end

  defp values({:float, bits}, [bytes], n),
    do: for(<<x::bitstring-known(bits) <- cut(bytes, n, bits)>>, do: float(x))

  defp values({:fixed, size}, [bytes], n),
    do: for(<<x::binary-known(size) <- cut(bytes, n, size * 8)>>, do: :binary.copy(x))

  defp values({kind, bits}, [_ends, _bytes], 0) when kind in [:text, :bytes] and bits in [32, 64],
    do: []

  defp values({kind, bits}, [ends, bytes], n) when kind in [:text, :bytes] do
    [first | ends] = for <<x::little-signed-known(bits) <- cut(ends, n + 1, bits)>>, do: x

    {values, _} =
      Enum.map_reduce(ends, first, &{:binary.copy(text(kind, bytes, &2, &1 - &2)), &1})

    values
  end

  defp values({:view, kind}, [views | data], n) do
    views = cut(views, n, 128)
    # Views may lie over one another: a small file could name much.
    all = for <<size::little-32, _::96 <- views>>, reduce: 0, do: (sum -> sum + size)
    if all > @most, do: fail("texts of #{all} bytes in one batch")
    data = List.to_tuple(data)
    for <<view::binary-16 <- views>>, do: view(kind, view, data)
  end

  defp values(_type, _buffers, _n), do: fail("a column without its buffers")

  # Up to twelve bytes stand in the view itself.
  defp view(kind, <<n::little-32, bytes::binary-12>>, _data) when n <= 12,
    do: kind |> text(bytes, 0, n) |> :binary.copy()

  defp view(kind, <<n::little-32, _prefix::32, which::little-32, at::little-32>>, data)
       when which < tuple_size(data),
       do: text(kind, elem(data, which), at, n)

  defp view(_kind, _view, _data), do: fail("a text in a buffer that is not there")

  defp text(kind, bytes, at, n) when at >= 0 and n >= 0 and at + n <= byte_size(bytes) do
    text = binary_part(bytes, at, n)

    if kind == :text and not String.valid?(text),
      do: fail("a text that is not UTF-8"),
      else: text
  end

  defp text(_kind, _bytes, _at, _n), do: fail("a text outside of its buffer")

  # The first of eight is the lowest.
  defp bits(bytes, n) do
    for(
      <<a::1, b::1, c::1, d::1, e::1, f::1, g::1, h::1 <- cut(bytes, div(n + 7, 8), 8)>>,
      bit <- [h, g, f, e, d, c, b, a],
      do: bit == 1
    )
    |> Enum.take(n)
  end

  defp cut(bytes, n, bits) when n >= 0 and n * bits <= bit_size(bytes),
    do: binary_part(bytes, 0, div(n * bits, 8))

  defp cut(_bytes, _n, _bits), do: fail("a buffer that is too short for its rows")

  defp float(<<x::little-float-64>>), do: x
  defp float(<<x::little-float-32>>), do: x
  defp float(<<x::little-float-16>>), do: x
  defp float(<<0::48, 0xF0, 0x7F>>), do: :infinity
  defp float(<<0::48, 0xF0, 0xFF>>), do: :neg_infinity
  defp float(<<0, 0, 0x80, 0x7F>>), do: :infinity
  defp float(<<0, 0, 0x80, 0xFF>>), do: :neg_infinity
  defp float(<<0, 0x7C>>), do: :infinity
  defp float(<<0, 0xFC>>), do: :neg_infinity
  defp float(_), do: :nan

  defp fail(why), do: throw({:not_arrow, why})
end

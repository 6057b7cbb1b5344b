defmodule Situ.Bridge.Arrow.Values do
  @moduledoc false
  # Reads a range of values of one column from the buffers of a batch. Pure, except for the reads of the buffers.
  # Throws `{:not_arrow, why}`.
  import Situ.Bits, only: [known: 1]
  alias Situ.Bridge.Arrow.Buffer

  @most 1_073_741_824
  @most_missing 10_000_000

  @typedoc """
  A column in a batch: `presence` is its validity bitmap, or `nil` if no value is missing; `children` are the nested
  columns by name; `entries` are the entries of its dictionary, if it has one.
  """
  @type column :: %{
          type: term(),
          rows: non_neg_integer(),
          presence: Buffer.t() | nil,
          buffers: [Buffer.t()],
          children: [{String.t(), column()}],
          entries: tuple() | nil
        }

  @doc """
  Reads the values of `n` rows, starting at the row `from`. Missing values are `nil`.

      iex> alias Situ.Bridge.Arrow.{Buffer, Values}
      iex> item = %{type: {:integer, 8, true}, rows: 4, presence: nil, buffers: [Buffer.from_binary(<<1, 2, 3, 4>>)]}
      iex> item = Map.merge(item, %{children: [], entries: nil})
      iex> lists = %{item | type: {:lists, 2}, rows: 2, presence: Buffer.from_binary(<<1>>), buffers: []}
      iex> lists = %{lists | children: [{"item", item}]}
      iex> {Values.read(lists, 0, 2), Values.read(lists, 1, 1)}
      {[[1, 2], nil], [nil]}
  """
  @spec read(column(), from :: integer(), n :: integer()) :: [term()]
  def read(%{rows: rows}, from, n) when from < 0 or n < 0 or from + n > rows,
    do: fail("a list extends beyond its items")

  def read(%{type: :null, rows: rows}, _from, n) when rows <= @most_missing,
    do: List.duplicate(nil, n)

  def read(%{type: :null, rows: rows}, _from, _n), do: fail("a column has #{rows} missing values")

  def read(%{presence: presence} = column, from, n) do
    values = column.type |> nested(column, from, n) |> put_entries(column.entries)
    bits = if presence == nil, do: List.duplicate(true, n), else: bits(presence, from, n)
    if presence == nil and column.entries == nil, do: values, else: present(bits, values)
  end

  defp put_entries(values, nil), do: values

  # The index of a missing value is arbitrary, so it may be out of range.
  defp put_entries(values, entries) do
    for i <- values,
        do: if(i in 0..(tuple_size(entries) - 1)//1, do: elem(entries, i), else: :beyond)
  end

  defp nested(:struct, column, from, n) do
    names = Enum.map(column.children, &elem(&1, 0))

    if Enum.any?(column.children, fn {_, child} -> child.rows != column.rows end),
      do: fail("the members of a struct column differ in their number of rows")

    column.children
    |> Enum.map(fn {_, child} -> read(child, from, n) end)
    |> Enum.zip_with(&(names |> Enum.zip(&1) |> Map.new()))
  end

  defp nested({:lists, size}, %{children: [{_, items}]}, from, n),
    do: items |> read(from * size, n * size) |> Enum.chunk_every(size)

  defp nested({:list, bits}, %{buffers: [ends], children: [{_, items}]}, from, n),
    do: lists(ends, bits, {from, n}, items)

  # The entries of a map are structs with two members.
  defp nested(:map, %{buffers: [ends], children: [{_, pairs}]}, from, n) do
    [{key, _}, {value, _}] = pairs.children

    for pairs <- lists(ends, 32, {from, n}, pairs),
        do: for(%{^key => name, ^value => held} <- pairs, into: %{}, do: {name, held})
  end

  defp nested(type, %{buffers: buffers}, from, n), do: values(type, buffers, from, n)

  defp lists(ends, bits, {from, n}, items) do
    [first | ends] = ends(ends, bits, from, n)
    last = List.last(ends, first)
    {lists, _} = Enum.map_reduce(ends, {first, read(items, first, last - first)}, &list/2)
    lists
  end

  # N values have N + 1 offsets, but writers may omit the offset of an empty column.
  defp ends(_ends, _bits, _from, 0), do: [0]

  defp ends(ends, bits, from, n) do
    for <<x::little-signed-known(bits) <- records(ends, from, n + 1, bits)>>, do: x
  end

  defp list(ends, {at, items}) do
    if ends < at, do: fail("a list ends before it begins")
    {list, rest} = Enum.split(items, ends - at)
    if length(list) != ends - at, do: fail("a list extends beyond its items")
    {list, {ends, rest}}
  end

  defp present([true | _], [:beyond | _]), do: fail("an index is outside its dictionary")
  defp present([true | bits], [value | values]), do: [value | present(bits, values)]
  defp present([false | bits], [_ | values]), do: [nil | present(bits, values)]
  defp present([], []), do: []

  defp values(:boolean, [bytes], from, n), do: bits(bytes, from, n)

  defp values({:integer, bits, true}, [bytes], from, n),
    do: for(<<x::little-signed-known(bits) <- records(bytes, from, n, bits)>>, do: x)

  defp values({:integer, bits, false}, [bytes], from, n),
    do: for(<<x::little-known(bits) <- records(bytes, from, n, bits)>>, do: x)

  defp values({:times, bits, factor, _}, [bytes], from, n),
    do: for(<<x::little-signed-known(bits) <- records(bytes, from, n, bits)>>, do: x * factor)

  defp values({:decimal, bits, scale}, [bytes], from, n) do
    unit = Integer.pow(10, scale)
    for <<x::little-signed-known(bits) <- records(bytes, from, n, bits)>>, do: x / unit
  end

  defp values({:float, bits}, [bytes], from, n),
    do: for(<<x::bitstring-known(bits) <- records(bytes, from, n, bits)>>, do: float(x))

  defp values({:fixed, size}, [bytes], from, n),
    do: for(<<x::binary-known(size) <- records(bytes, from, n, size * 8)>>, do: :binary.copy(x))

  defp values({kind, bits}, [ends, bytes], from, n)
       when kind in [:text, :bytes] and bits in [32, 64] do
    [first | ends] = ends(ends, bits, from, n)
    if List.last(ends, first) < first, do: fail("a string is outside its buffer")
    bytes = Buffer.read(bytes, first, List.last(ends, first) - first)

    {values, _} =
      Enum.map_reduce(ends, 0, fn ends, at ->
        {:binary.copy(text(kind, bytes, at, ends - first - at)), ends - first}
      end)

    values
  end

  defp values({:view, kind}, [views | data], from, n) do
    views = records(views, from, n, 128)
    # Views may overlap, so a small file could describe a huge amount of data.
    all = for <<size::little-32, _::96 <- views>>, reduce: 0, do: (sum -> sum + size)
    if all > @most, do: fail("the strings of one batch have #{all} bytes")
    data = List.to_tuple(data)
    for <<view::binary-16 <- views>>, do: view(kind, view, data)
  end

  defp values(_type, _buffers, _from, _n), do: fail("the buffers of a column are missing")

  # Strings of up to twelve bytes are stored in the view itself.
  defp view(kind, <<n::little-32, bytes::binary-12>>, _data) when n <= 12,
    do: kind |> text(bytes, 0, n) |> :binary.copy()

  defp view(kind, <<n::little-32, _prefix::32, which::little-32, at::little-32>>, data)
       when which < tuple_size(data),
       do: text(kind, data |> elem(which) |> Buffer.read(at, n), 0, n)

  defp view(_kind, _view, _data), do: fail("a string is in a buffer that does not exist")

  defp text(kind, bytes, at, n) when at >= 0 and n >= 0 and at + n <= byte_size(bytes) do
    text = binary_part(bytes, at, n)

    if kind == :text and not String.valid?(text),
      do: fail("a string is not valid UTF-8"),
      else: text
  end

  defp text(_kind, _bytes, _at, _n), do: fail("a string is outside its buffer")

  # The first value of a byte is in its lowest bit.
  defp bits(buffer, from, n) do
    before = rem(from, 8)

    for(
      <<a::1, b::1, c::1, d::1, e::1, f::1, g::1,
        h::1 <-
          Buffer.read(buffer, div(from, 8), div(before + n + 7, 8))>>,
      bit <- [h, g, f, e, d, c, b, a],
      do: bit == 1
    )
    |> Enum.slice(before, n)
  end

  defp records(buffer, from, n, bits),
    do: Buffer.read(buffer, from * div(bits, 8), n * div(bits, 8))

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

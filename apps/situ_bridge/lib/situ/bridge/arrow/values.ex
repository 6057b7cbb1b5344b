defmodule Situ.Bridge.Arrow.Values do
  @moduledoc false
  # Reads a range of values of one column from the buffers of a batch. Pure, except for the reads of the buffers.
  # Throws `{:not_arrow, why}`.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Arrow.Buffer
  alias Situ.Bridge.Columnar.Column

  @max_bytes 1_073_741_824
  @max_missing 10_000_000

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
      iex> {Values.read_rows(lists, 0, 2), Values.read_rows(lists, 1, 1)}
      {[[1, 2], nil], [nil]}
  """
  @spec read_rows(column(), from :: integer(), n :: integer()) :: [term()]
  def read_rows(%{rows: rows}, from, n) when from < 0 or n < 0 or from + n > rows,
    do: throw_malformed("a list extends beyond its items")

  def read_rows(%{type: :null, rows: rows}, _from, n) when rows <= @max_missing,
    do: List.duplicate(nil, n)

  def read_rows(%{type: :null, rows: rows}, _from, _n),
    do: throw_malformed("a column has #{rows} missing values")

  def read_rows(%{presence: presence} = column, from, n) do
    values = column.type |> read_nested(column, from, n) |> put_entries(column.entries)
    bits = if presence == nil, do: List.duplicate(true, n), else: read_bits(presence, from, n)
    if presence == nil and column.entries == nil, do: values, else: mask_missing(bits, values)
  end

  defp put_entries(values, nil), do: values

  # The index of a missing value is arbitrary, so it may be out of range.
  defp put_entries(values, entries) do
    for i <- values,
        do: if(i in 0..(tuple_size(entries) - 1)//1, do: elem(entries, i), else: :beyond)
  end

  defp read_nested(:struct, column, from, n) do
    names = Enum.map(column.children, &elem(&1, 0))

    if Enum.any?(column.children, fn {_, child} -> child.rows != column.rows end),
      do: throw_malformed("the members of a struct column differ in their number of rows")

    column.children
    |> Enum.map(fn {_, child} -> read_rows(child, from, n) end)
    |> Enum.zip_with(&(names |> Enum.zip(&1) |> Map.new()))
  end

  defp read_nested({:lists, size}, %{children: [{_, items}]}, from, n),
    do: items |> read_rows(from * size, n * size) |> Enum.chunk_every(size)

  defp read_nested({:list, bits}, %{buffers: [ends], children: [{_, items}]}, from, n),
    do: read_lists(ends, bits, {from, n}, items)

  # The entries of a map are structs with two members.
  defp read_nested(:map, %{buffers: [ends], children: [{_, pairs}]}, from, n) do
    [{key, _}, {value, _}] = pairs.children

    for pairs <- read_lists(ends, 32, {from, n}, pairs),
        do: for(%{^key => name, ^value => member} <- pairs, into: %{}, do: {name, member})
  end

  defp read_nested(type, %{buffers: buffers}, from, n), do: read_flat(type, buffers, from, n)

  defp read_lists(ends, bits, {from, n}, items) do
    [first | ends] = read_ends(ends, bits, from, n)
    last = List.last(ends, first)

    {lists, _} =
      Enum.map_reduce(ends, {first, read_rows(items, first, last - first)}, &split_list/2)

    lists
  end

  # N values have N + 1 offsets, but writers may omit the offset of an empty column.
  defp read_ends(_ends, _bits, _from, 0), do: [0]

  defp read_ends(ends, bits, from, n) do
    for <<x::little-signed-pinned_size(bits) <- record_bytes(ends, from, n + 1, bits)>>, do: x
  end

  defp split_list(ends, {at, items}) do
    if ends < at, do: throw_malformed("a list ends before it begins")
    {list, rest} = Enum.split(items, ends - at)
    if length(list) != ends - at, do: throw_malformed("a list extends beyond its items")
    {list, {ends, rest}}
  end

  defp mask_missing([true | _], [:beyond | _]),
    do: throw_malformed("an index is outside its dictionary")

  defp mask_missing([true | bits], [value | values]), do: [value | mask_missing(bits, values)]
  defp mask_missing([false | bits], [_ | values]), do: [nil | mask_missing(bits, values)]
  defp mask_missing([], []), do: []

  defp read_flat(:boolean, [bytes], from, n), do: read_bits(bytes, from, n)

  defp read_flat({:integer, bits, true}, [bytes], from, n),
    do: for(<<x::little-signed-pinned_size(bits) <- record_bytes(bytes, from, n, bits)>>, do: x)

  defp read_flat({:integer, bits, false}, [bytes], from, n),
    do: for(<<x::little-pinned_size(bits) <- record_bytes(bytes, from, n, bits)>>, do: x)

  defp read_flat({:times, bits, factor, _}, [bytes], from, n),
    do:
      for(<<x::little-signed-pinned_size(bits) <- record_bytes(bytes, from, n, bits)>>,
        do: x * factor
      )

  defp read_flat({:decimal, bits, scale}, [bytes], from, n) do
    unit = Integer.pow(10, scale)
    for <<x::little-signed-pinned_size(bits) <- record_bytes(bytes, from, n, bits)>>, do: x / unit
  end

  defp read_flat({:float, bits}, [bytes], from, n),
    do: bytes |> record_bytes(from, n, bits) |> Situ.Number.decode_floats(div(bits, 8))

  defp read_flat({:fixed, size}, [bytes], from, n),
    do:
      for(<<x::binary-pinned_size(size) <- record_bytes(bytes, from, n, size * 8)>>,
        do: :binary.copy(x)
      )

  defp read_flat({kind, bits}, [ends, bytes], from, n)
       when kind in [:text, :bytes] and bits in [32, 64] do
    [first | ends] = read_ends(ends, bits, from, n)
    if List.last(ends, first) < first, do: throw_malformed("a string is outside its buffer")
    bytes = Buffer.read_bytes(bytes, first, List.last(ends, first) - first)

    {values, _} =
      Enum.map_reduce(ends, 0, fn ends, at ->
        {:binary.copy(slice_text(kind, bytes, at, ends - first - at)), ends - first}
      end)

    values
  end

  defp read_flat({:view, kind}, [views | data], from, n) do
    views = record_bytes(views, from, n, 128)
    # Views may overlap, so a small file could describe a huge amount of data.
    total = for <<size::little-32, _::96 <- views>>, reduce: 0, do: (sum -> sum + size)
    if total > @max_bytes, do: throw_malformed("the strings of one batch have #{total} bytes")
    data = List.to_tuple(data)
    for <<view::binary-16 <- views>>, do: resolve_view(kind, view, data)
  end

  defp read_flat(_type, _buffers, _from, _n),
    do: throw_malformed("the buffers of a column are missing")

  # Strings of up to twelve bytes are stored in the view itself.
  defp resolve_view(kind, <<n::little-32, bytes::binary-12>>, _data) when n <= 12,
    do: kind |> slice_text(bytes, 0, n) |> :binary.copy()

  defp resolve_view(kind, <<n::little-32, _prefix::32, index::little-32, at::little-32>>, data)
       when index < tuple_size(data),
       do: slice_text(kind, data |> elem(index) |> Buffer.read_bytes(at, n), 0, n)

  defp resolve_view(_kind, _view, _data),
    do: throw_malformed("a string is in a buffer that does not exist")

  defp slice_text(kind, bytes, at, n) when at >= 0 and n >= 0 and at + n <= byte_size(bytes) do
    text = binary_part(bytes, at, n)

    if kind == :text and not String.valid?(text),
      do: throw_malformed("a string is not valid UTF-8"),
      else: text
  end

  defp slice_text(_kind, _bytes, _at, _n), do: throw_malformed("a string is outside its buffer")

  defp read_bits(buffer, from, n) do
    skipped = rem(from, 8)

    buffer
    |> Buffer.read_bytes(div(from, 8), div(skipped + n + 7, 8))
    |> Column.unpack_bits()
    |> Enum.slice(skipped, n)
  end

  defp record_bytes(buffer, from, n, bits),
    do: Buffer.read_bytes(buffer, from * div(bits, 8), n * div(bits, 8))

  defp throw_malformed(why), do: throw({:not_arrow, why})
end

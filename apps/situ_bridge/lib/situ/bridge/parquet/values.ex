defmodule Situ.Bridge.Parquet.Values do
  @moduledoc false
  # The values of a column chunk: its pages, one after the other. Pure, but for what unpacks.
  # Throws `{:not_parquet, why}`.
  import Situ.Bits, only: [known: 1]
  alias Situ.Bridge.Parquet.{Deltas, Leaf, Packed, Runs, Thrift}

  @encodings %{4 => "BIT_PACKED"}
  @most_page 1_073_741_824
  # Levels pack well: a small file could name very many.
  @most_entries 20_000_000

  @doc "All values of a chunk with so many rows; `nil` where one is missing."
  @spec read(Leaf.t(), binary(), codec :: integer(), rows :: non_neg_integer()) :: [term()]
  def read(leaf, bytes, codec, rows), do: pages({leaf, :flat}, bytes, codec, rows, nil, [])

  @doc "All values of a leaf within a tree, with their levels of repetition and definition."
  @spec entries(Leaf.t(), binary(), codec :: integer(), count :: term()) :: [
          {non_neg_integer(), non_neg_integer(), term()}
        ]
  def entries(leaf, bytes, codec, count) when count in 0..@most_entries,
    do: pages({leaf, :nested}, bytes, codec, count, nil, [])

  def entries(leaf, _bytes, _codec, count),
    do: fail("a row group with #{inspect(count)} values of #{inspect(leaf.name)}")

  defp pages(_how, _bytes, _codec, 0, _dictionary, found),
    do: found |> Enum.reverse() |> Enum.concat()

  defp pages({leaf, _} = how, bytes, codec, left, dictionary, found) do
    {head, rest} = Thrift.read(bytes)
    {size, stored} = {head[2], head[3]}

    unless is_integer(size) and is_integer(stored) and stored in 0..byte_size(rest) and
             size in 0..@most_page,
           do: fail("a page of #{inspect(stored)} bytes in #{byte_size(rest)}")

    <<body::binary-known(stored), rest::binary>> = rest

    case head do
      %{1 => 2, 7 => %{1 => n}} when is_integer(n) ->
        dictionary = leaf |> plain(Packed.undo(codec, body, size), n) |> List.to_tuple()
        pages(how, rest, codec, left, dictionary, found)

      %{1 => 0, 5 => %{1 => n, 2 => encoding}} when n in 1..left//1 ->
        values = data(how, Packed.undo(codec, body, size), n, encoding, dictionary)
        pages(how, rest, codec, left - n, dictionary, [values | found])

      %{1 => 3, 8 => %{1 => n, 4 => encoding} = v2} when n in 1..left//1 ->
        values = data2(how, body, {codec, size}, n, encoding, v2, dictionary)
        pages(how, rest, codec, left - n, dictionary, [values | found])

      %{1 => kind} when kind not in [0, 2, 3] ->
        pages(how, rest, codec, left, dictionary, found)

      _ ->
        fail("a page's header is malformed")
    end
  end

  defp data({leaf, _} = how, bytes, n, encoding, dictionary) do
    {repeats, bytes} = levels(bytes, leaf.repetition)
    {defines, bytes} = levels(bytes, leaf.definition)
    put(how, {repeats, defines}, n, &values(leaf, encoding, bytes, &1, dictionary))
  end

  # Levels of 0 are not written.
  defp levels(bytes, 0), do: {"", bytes}

  defp levels(<<n::little-32, levels::binary-size(n), bytes::binary>>, _most),
    do: {levels, bytes}

  defp levels(_bytes, _most), do: fail("levels that do not fit into their page")

  # The second kind of page has its levels outside of what is packed.
  defp data2({leaf, _} = how, body, {codec, size}, n, encoding, v2, dictionary) do
    repeats = v2[6] || 0
    defines = v2[5] || 0

    unless repeats in 0..byte_size(body) and defines in 0..(byte_size(body) - repeats)//1,
      do: fail("levels that do not fit into their page")

    <<repeat::binary-known(repeats), define::binary-known(defines), packed::binary>> = body

    unpacked =
      if v2[7] == false,
        do: packed,
        else: Packed.undo(codec, packed, max(size - defines - repeats, 0))

    put(how, {repeat, define}, n, &values(leaf, encoding, unpacked, &1, dictionary))
  end

  defp put({%{definition: 0}, :flat}, _levels, n, values), do: values.(n)

  defp put({_leaf, :flat}, {_repeats, defines}, n, values) do
    levels = Runs.read(defines, 1, n)
    spread(levels, values.(Enum.sum(levels)))
  end

  defp put({leaf, :nested}, {repeats, defines}, n, values) do
    repeats = Runs.read(repeats, width(leaf.repetition), n)
    defines = Runs.read(defines, width(leaf.definition), n)

    levelled(
      repeats,
      defines,
      leaf.definition,
      values.(Enum.count(defines, &(&1 == leaf.definition)))
    )
  end

  defp width(0), do: 0
  defp width(most), do: most |> Integer.digits(2) |> length()

  defp levelled([r | repeats], [d | defines], d, [value | values]),
    do: [{r, d, value} | levelled(repeats, defines, d, values)]

  defp levelled([r | repeats], [d | defines], most, values) when d < most,
    do: [{r, d, nil} | levelled(repeats, defines, most, values)]

  defp levelled([], [], _most, []), do: []
  defp levelled(_, _, _, _), do: fail("more levels than values")

  defp spread([1 | levels], [value | values]), do: [value | spread(levels, values)]
  defp spread([0 | levels], values), do: [nil | spread(levels, values)]
  defp spread([], []), do: []
  defp spread(_, _), do: fail("more levels than values")

  defp values(leaf, 0, bytes, n, _dictionary), do: plain(leaf, bytes, n)
  defp values(_leaf, encoding, _bytes, 0, _dictionary) when encoding in [2, 8], do: []

  defp values(_leaf, encoding, <<width, bytes::binary>>, n, dictionary)
       when encoding in [2, 8] and dictionary != nil do
    for i <- Runs.read(bytes, width, n) do
      if i < tuple_size(dictionary),
        do: elem(dictionary, i),
        else: fail("a number beyond the dictionary")
    end
  end

  defp values(%{type: 0}, 3, <<size::little-32, bytes::binary-size(size), _::binary>>, n, _),
    do: for(bit <- Runs.read(bytes, 1, n), do: bit == 1)

  defp values(%{type: type} = leaf, 5, bytes, n, _dictionary) when type in [1, 2] do
    {values, _rest} = Runs.deltas(bytes, n)
    if length(values) != n, do: fail("another number of values than the page says")
    Enum.map(values, &converted(&1, leaf.as))
  end

  defp values(%{type: 6} = leaf, 6, bytes, n, _dictionary),
    do: bytes |> Deltas.texts(n) |> Enum.map(&Leaf.meant(&1, leaf.as))

  defp values(%{type: type} = leaf, 7, bytes, n, _dictionary) when type in [6, 7],
    do: bytes |> Deltas.prefixed(n) |> Enum.map(&Leaf.meant(&1, leaf.as))

  defp values(leaf, 9, bytes, n, _dictionary),
    do: plain(leaf, Deltas.streams(bytes, size(leaf), n), n)

  defp values(_leaf, encoding, _bytes, _n, _dictionary),
    do:
      fail(
        "values are written as #{@encodings[encoding] || inspect(encoding)}, which is not read here"
      )

  defp size(%{type: type}) when type in [1, 4], do: 4
  defp size(%{type: type}) when type in [2, 5], do: 8
  defp size(%{type: 7, length: length}) when length > 0, do: length
  defp size(_leaf), do: fail("values whose bytes are apart, of no size")

  # Every value takes a bit at least, so no memory is asked for that the bytes do not fill.
  defp plain(leaf, bytes, n) do
    values = all(leaf, bytes, n)
    if length(values) != n, do: fail("another number of values than the page says"), else: values
  end

  defp all(%{type: 0}, bytes, n) do
    for(
      <<a::1, b::1, c::1, d::1, e::1, f::1, g::1, h::1 <- bytes>>,
      bit <- [h, g, f, e, d, c, b, a],
      do: bit == 1
    )
    |> Enum.take(n)
  end

  defp all(%{type: 1, as: as}, bytes, n),
    do: for(<<x::little-signed-32 <- cut(bytes, n * 4)>>, do: converted(x, as))

  defp all(%{type: 2, as: as}, bytes, n),
    do: for(<<x::little-signed-64 <- cut(bytes, n * 8)>>, do: converted(x, as))

  defp all(%{type: 3}, bytes, n),
    do:
      for(<<ns::little-64, day::little-32 <- cut(bytes, n * 12)>>,
        do: (day - 2_440_588) * 86_400_000_000_000 + ns
      )

  defp all(%{type: 4}, bytes, n), do: for(<<x::binary-4 <- cut(bytes, n * 4)>>, do: float(x))
  defp all(%{type: 5}, bytes, n), do: for(<<x::binary-8 <- cut(bytes, n * 8)>>, do: float(x))
  defp all(%{type: 6, as: as}, bytes, n), do: texts(bytes, n, as, [])

  defp all(%{type: 7, length: length, as: as}, bytes, n) when length > 0,
    do:
      for(
        <<x::binary-known(length) <- cut(bytes, n * length)>>,
        do: x |> :binary.copy() |> Leaf.meant(as)
      )

  defp all(_leaf, _bytes, _n), do: fail("values of no size")

  defp cut(bytes, n) when byte_size(bytes) >= n, do: binary_part(bytes, 0, n)
  defp cut(_bytes, _n), do: fail("a page with too few values")

  defp texts(_bytes, 0, _as, found), do: Enum.reverse(found)

  defp texts(<<n::little-32, text::binary-size(n), rest::binary>>, left, as, found),
    do: texts(rest, left - 1, as, [text |> :binary.copy() |> Leaf.meant(as) | found])

  defp texts(_short, _left, _as, _found), do: fail("a text that is cut short")

  defp float(<<x::little-float-64>>), do: x
  defp float(<<x::little-float-32>>), do: x
  defp float(<<0::48, 0xF0, 0x7F>>), do: :infinity
  defp float(<<0::48, 0xF0, 0xFF>>), do: :neg_infinity
  defp float(<<0, 0, 0x80, 0x7F>>), do: :infinity
  defp float(<<0, 0, 0x80, 0xFF>>), do: :neg_infinity
  defp float(_), do: :nan

  defp converted(n, nil), do: n
  defp converted(n, {:times, factor}), do: n * factor
  defp converted(n, {:scale, scale}), do: n / Integer.pow(10, scale)
  defp converted(n, {:unsigned, bits}) when n < 0, do: n + Integer.pow(2, bits)
  defp converted(n, {:unsigned, _}), do: n

  defp fail(why), do: throw({:not_parquet, why})
end

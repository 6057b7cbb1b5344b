defmodule Situ.Bridge.Parquet.Page do
  @moduledoc false
  # One page of a column's values: its levels and its values, taken a few at a time. Pure, except for unpacking.
  # Throws `{:not_parquet, why}`.
  import Situ.BinarySize, only: [pinned_size: 1]
  alias Situ.Bridge.Parquet.{Leaf, Compression, RunLength, Values}

  @max_bytes 1_073_741_824

  @enforce_keys [:leaf, :remaining, :repeats, :defines, :values]
  defstruct @enforce_keys

  @typedoc "`remaining` is the number of entries that have not been taken yet."
  @type t :: %__MODULE__{
          leaf: Leaf.t(),
          remaining: non_neg_integer(),
          repeats: RunLength.t(),
          defines: RunLength.t(),
          values: Values.t()
        }

  @typedoc "The compression of a column chunk; `packed?` means that compressed pages may be declared as uncompressed."
  @type packing :: %{codec: integer(), packed?: boolean()}

  @typedoc "A value with its repetition and definition levels, or only the value for flat columns."
  @type entry :: {non_neg_integer(), non_neg_integer(), term()} | term()

  @doc "Returns the size of a page's body in the file, from its header. Throws if it exceeds `limit`."
  @spec stored_size(map(), limit :: non_neg_integer()) :: non_neg_integer()
  def stored_size(%{2 => size, 3 => stored}, limit)
      when stored in 0..limit//1 and size in 0..@max_bytes,
      do: stored

  def stored_size(head, limit),
    do: throw_malformed("a page of #{inspect(head[3])} bytes in #{limit} bytes")

  @doc "Decodes the entries of a dictionary page."
  @spec decode_dictionary(map(), binary(), Leaf.t(), packing()) :: Values.dictionary()
  def decode_dictionary(%{2 => size, 7 => %{1 => n}}, body, leaf, packing)
      when is_integer(n) and n >= 0 do
    Values.start_dictionary(leaf, Compression.unpack_page(packing.codec, body, size), n)
  end

  def decode_dictionary(_head, _body, _leaf, _packing),
    do: throw_malformed("a page's header is malformed")

  @doc "Starts decoding a page of at most `max` entries; returns `nil` if the page holds no values."
  @spec start_decoding(
          map(),
          binary(),
          {Leaf.t(), packing(), Values.dictionary() | nil},
          max :: pos_integer()
        ) ::
          t() | nil
  def start_decoding(%{1 => 0, 2 => size, 5 => %{1 => n, 2 => encoding}}, body, column, max)
      when n in 0..max//1 do
    {leaf, packing, dictionary} = column
    bytes = Compression.unpack_page(packing.codec, body, size)
    {repeats, bytes} = split_levels(bytes, leaf.repetition)
    {defines, bytes} = split_levels(bytes, leaf.definition)
    build_page(leaf, n, {repeats, defines}, {encoding, bytes, dictionary})
  end

  # The levels of a version 2 data page are not compressed.
  def start_decoding(
        %{1 => 3, 2 => size, 8 => %{1 => n, 4 => encoding} = head},
        body,
        column,
        max
      )
      when n in 0..max//1 do
    {leaf, packing, dictionary} = column
    {repeats, defines} = {head[6] || 0, head[5] || 0}

    unless repeats in 0..byte_size(body) and defines in 0..(byte_size(body) - repeats)//1,
      do: throw_malformed("the levels do not fit into their page")

    <<repeat::binary-pinned_size(repeats), define::binary-pinned_size(defines), rest::binary>> =
      body

    size = max(size - defines - repeats, 0)

    # pyarrow before version 3 compresses such pages but declares them as uncompressed; the sizes reveal it.
    plain? = head[7] == false and not packing.packed? and size == byte_size(rest)
    bytes = if plain?, do: rest, else: Compression.unpack_page(packing.codec, rest, size)
    build_page(leaf, n, {repeat, define}, {encoding, bytes, dictionary})
  end

  def start_decoding(%{1 => kind}, _body, _column, _max) when kind not in [0, 2, 3], do: nil

  def start_decoding(_head, _body, _column, _max),
    do: throw_malformed("a page's header is malformed")

  # If the maximum level is 0, no levels are written.
  defp split_levels(bytes, 0), do: {"", bytes}

  defp split_levels(<<n::little-32, levels::binary-size(n), bytes::binary>>, _max),
    do: {levels, bytes}

  defp split_levels(_bytes, _max), do: throw_malformed("the levels do not fit into their page")

  defp build_page(leaf, n, {repeats, defines}, {encoding, bytes, dictionary}) do
    %__MODULE__{
      leaf: leaf,
      remaining: n,
      repeats: RunLength.from_bytes(repeats, level_width(leaf.repetition)),
      defines: RunLength.from_bytes(defines, level_width(leaf.definition)),
      values: Values.start_decoding(leaf, encoding, bytes, n, dictionary)
    }
  end

  defp level_width(0), do: 0
  defp level_width(max), do: max |> Integer.digits(2) |> length()

  @doc "Takes the next `n` values of a flat column, `nil` where one is missing."
  @spec take_values(t(), non_neg_integer()) :: {[term()], t()}
  def take_values(%{leaf: %{definition: 0}} = page, n) do
    {values, left} = Values.take_next(page.values, n)
    {values, count_taken(%{page | values: left}, n)}
  end

  def take_values(page, n) do
    {defines, defines_left} = RunLength.take_numbers(page.defines, n)
    {values, values_left} = Values.take_next(page.values, Enum.count(defines, &(&1 == 1)))
    page = %{page | defines: defines_left, values: values_left}
    {put_missing(defines, values), count_taken(page, n)}
  end

  defp put_missing([1 | defines], [value | values]), do: [value | put_missing(defines, values)]
  defp put_missing([_ | defines], values), do: [nil | put_missing(defines, values)]
  defp put_missing([], []), do: []

  @doc "Takes the next `n` values of a nested column, with their levels."
  @spec take_entries(t(), non_neg_integer()) :: {[entry()], t()}
  def take_entries(%{leaf: %{definition: max}} = page, n) do
    {repeats, repeats_left} = RunLength.take_numbers(page.repeats, n)
    {defines, defines_left} = RunLength.take_numbers(page.defines, n)
    {values, values_left} = Values.take_next(page.values, Enum.count(defines, &(&1 == max)))
    page = %{page | repeats: repeats_left, defines: defines_left, values: values_left}
    {put_levels(repeats, defines, max, values), count_taken(page, n)}
  end

  defp put_levels([r | repeats], [d | defines], d, [value | values]),
    do: [{r, d, value} | put_levels(repeats, defines, d, values)]

  defp put_levels([r | repeats], [d | defines], max, values) when d < max,
    do: [{r, d, nil} | put_levels(repeats, defines, max, values)]

  defp put_levels([], [], _max, []), do: []

  defp put_levels(_, _, _, _),
    do: throw_malformed("a level exceeds the maximum level of its column")

  defp count_taken(%{remaining: n} = page, n) do
    if Values.left_over?(page.values),
      do: throw_malformed("a page has more values than it declares")

    %{page | remaining: 0}
  end

  defp count_taken(page, n), do: %{page | remaining: page.remaining - n}

  defp throw_malformed(why), do: throw({:not_parquet, why})
end

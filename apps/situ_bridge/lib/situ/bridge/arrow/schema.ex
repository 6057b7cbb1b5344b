defmodule Situ.Bridge.Arrow.Schema do
  @moduledoc false
  # The schema of an Arrow file (Schema.fbs). Encodes columns as a schema, and decodes a schema into the type of each
  # column and the position of its buffers in a batch. Pure. Throws `{:not_arrow, why}`.
  alias Situ.Bridge.Arrow.FlatBuffer
  alias Situ.Bridge.Columnar.{Column, ColumnNames}

  @max_depth 64
  # The value of MetadataVersion.V5.
  @version_1_0 4
  @kinds %{
    0 => "nothing",
    1 => "null",
    2 => "integer",
    3 => "float",
    4 => "binary",
    5 => "text",
    6 => "boolean",
    7 => "decimal",
    8 => "date",
    9 => "time",
    10 => "timestamp",
    11 => "interval",
    12 => "list",
    13 => "struct",
    14 => "union",
    15 => "fixed_size_binary",
    16 => "fixed_size_list",
    17 => "map",
    18 => "duration",
    21 => "large_list",
    22 => "run_end_encoded",
    25 => "list_view",
    26 => "large_list_view"
  }
  @nanoseconds %{0 => 1_000_000_000, 1 => 1_000_000, 2 => 1_000, 3 => 1}

  @typedoc """
  A readable column. `node`, `buffer` and `view` are the numbers of nodes, buffers and string views before it in a
  batch. If its values are indexes (of the type `index`) into a dictionary, `dictionary` is the id of that dictionary.
  Lists, maps and structs have `children`.
  """
  @type column :: %{
          name: String.t(),
          type: term(),
          time?: boolean(),
          node: non_neg_integer(),
          buffer: non_neg_integer(),
          view: non_neg_integer(),
          dictionary: integer() | nil,
          index: term(),
          children: [column()]
        }

  @doc "Encodes the schema of these columns."
  @spec encode_columns([Column.t()]) :: FlatBuffer.t()
  def encode_columns(columns),
    do: {:table, [{0, {:i16, 0}}, {1, {:ref, {:vector, Enum.map(columns, &encode_field/1)}}}]}

  defp encode_field(column) do
    {number, fields} = encode_type(column.kind)

    {:table,
     [
       {0, {:ref, {:string, column.name}}},
       {1, {:bool, column.optional?}},
       {2, {:u8, number}},
       {3, {:ref, {:table, fields}}},
       {5, {:ref, {:vector, []}}}
     ]}
  end

  defp encode_type(:integer), do: {2, [{0, {:i32, 64}}, {1, {:bool, true}}]}
  defp encode_type(:float), do: {3, [{0, {:i16, 2}}]}
  defp encode_type(:boolean), do: {6, []}
  defp encode_type(:time), do: {10, [{0, {:i16, 3}}, {1, {:ref, {:string, "UTC"}}}]}
  defp encode_type(:bytes), do: {19, []}
  defp encode_type(:text), do: {20, []}

  @doc """
  Returns the readable columns, the names and types of the other columns, and for each dictionary id the column that
  holds its entries. If several columns have the same name, the later ones are numbered.
  """
  @spec decode_columns(binary(), non_neg_integer(), version :: integer()) ::
          {[column()], [{name :: String.t(), type :: String.t()}], %{integer() => column()}}
  def decode_columns(bytes, schema, version) do
    if FlatBuffer.read_number(bytes, schema, 0, :i16, 0) != 0,
      do: throw({:not_arrow, "its numbers are big-endian"})

    fields = FlatBuffer.table_offsets(bytes, schema, 1)
    {results, _positions} = Enum.map_reduce(fields, {0, 0, 0}, &decode_column(bytes, &1, &2, 0))

    # Before version 5, unions had an additional buffer, which would shift the buffers of all later columns.
    if version < @version_1_0 and Enum.any?(fields, &contains_union?(bytes, &1)),
      do: throw({:not_arrow, "it has unions in the format used before Arrow 1.0"})

    results = ColumnNames.number_duplicates(results)
    {left_out, columns} = Enum.split_with(results, &is_map_key(&1, :left_out))
    left_out = for column <- left_out, do: {column.name, column.left_out}
    {columns, left_out, columns |> Enum.flat_map(&dictionary_columns/1) |> Map.new()}
  end

  defp contains_union?(bytes, field) do
    FlatBuffer.read_number(bytes, field, 2, :u8, 0) == 14 or
      bytes |> FlatBuffer.table_offsets(field, 5) |> Enum.any?(&contains_union?(bytes, &1))
  end

  defp dictionary_columns(%{dictionary: nil, children: children}),
    do: Enum.flat_map(children, &dictionary_columns/1)

  # The batch of a dictionary contains only this column.
  defp dictionary_columns(%{dictionary: id} = column) do
    base = %{node: 0, buffer: 0, view: 0, dictionary: nil, index: nil, time?: false}
    [{id, Map.merge(column, Map.put(base, :name, "dictionary #{id}"))}]
  end

  defp decode_column(_bytes, _field, _position, depth) when depth > @max_depth,
    do: throw({:not_arrow, "its fields are nested too deeply"})

  defp decode_column(bytes, field, {node, buffer, view} = position, depth) do
    name = FlatBuffer.read_string(bytes, field, 0) || ""
    type = decode_type(bytes, field)
    {id, index} = decode_dictionary(bytes, field)
    next_position = skip_field(bytes, field, position, 0)
    children = if id == nil, do: decode_children(type, bytes, field, position, depth), else: []

    case unreadable_kind(bytes, field, {type, id, index, children}) do
      nil ->
        column = %{
          children: children,
          name: name,
          type: type,
          time?: match?({:times, _bits, _factor, true}, type),
          node: node,
          buffer: buffer,
          view: view,
          dictionary: id,
          index: index
        }

        {column, next_position}

      kind ->
        {%{name: name, left_out: kind}, next_position}
    end
  end

  # Describes the type of an unreadable column; returns `nil` if the column is readable.
  defp unreadable_kind(bytes, field, {type, id, index, children}) do
    kind = kind_name(FlatBuffer.read_number(bytes, field, 2, :u8, 0))

    cond do
      type == :unknown -> kind
      index == :unknown -> "dictionary of unknown numbers"
      id != nil and nested_type?(type) -> "dictionary of #{kind}s"
      match?({:left_out, _}, children) -> "#{kind} of #{elem(children, 1)}"
      true -> nil
    end
  end

  defp kind_name(kind), do: Map.get(@kinds, kind, "type #{kind}")

  # Decodes the columns inside a list, map or struct. The first one follows the parent's own buffers.
  defp decode_children(type, bytes, field, {node, buffer, view}, depth) do
    if nested_type?(type) do
      kind = FlatBuffer.read_number(bytes, field, 2, :u8, 0)
      position = {node + 1, buffer + buffer_count(kind, bytes, field), view}

      {results, _} =
        bytes
        |> FlatBuffer.table_offsets(field, 5)
        |> Enum.map_reduce(position, &decode_column(bytes, &1, &2, depth + 1))

      check_children(type, ColumnNames.number_duplicates(results))
    else
      []
    end
  end

  defp check_children(type, children) do
    case {Enum.find(children, &is_map_key(&1, :left_out)), type, children} do
      {%{left_out: kind}, _, _} -> {:left_out, kind}
      {nil, :struct, [_ | _]} -> children
      {nil, :map, [%{type: :struct, dictionary: nil, children: [_, _]}]} -> children
      {nil, {_list, _}, [_]} -> children
      _ -> {:left_out, "unsuitable columns"}
    end
  end

  defp nested_type?(type),
    do: type in [:struct, :map] or match?({l, _} when l in [:list, :lists], type)

  defp decode_dictionary(bytes, field) do
    case FlatBuffer.object_offset(bytes, field, 4) do
      nil ->
        {nil, nil}

      encoding ->
        index = FlatBuffer.object_offset(bytes, encoding, 1)
        type = if index, do: decode_number_type(bytes, 2, index), else: {:integer, 32, true}
        {FlatBuffer.read_number(bytes, encoding, 0, :i64, 0), type}
    end
  end

  # Counts the nodes, buffers and string views of a field and its descendants.
  defp skip_field(_bytes, _field, _position, depth) when depth > @max_depth,
    do: throw({:not_arrow, "its fields are nested too deeply"})

  defp skip_field(bytes, field, {node, buffer, view}, depth) do
    kind = FlatBuffer.read_number(bytes, field, 2, :u8, 0)

    if FlatBuffer.object_offset(bytes, field, 4) do
      {node + 1, buffer + 2, view}
    else
      position = {node + 1, buffer + buffer_count(kind, bytes, field), view + view_count(kind)}

      bytes
      |> FlatBuffer.table_offsets(field, 5)
      |> Enum.reduce(position, &skip_field(bytes, &1, &2, depth + 1))
    end
  end

  # Null and run-end encoded columns have no buffers; structs and fixed-size lists have only a validity bitmap.
  defp buffer_count(kind, _bytes, _field) when kind in [1, 22], do: 0
  defp buffer_count(kind, _bytes, _field) when kind in [13, 16], do: 1
  defp buffer_count(kind, _bytes, _field) when kind in [4, 5, 19, 20, 25, 26], do: 3

  defp buffer_count(14, bytes, field) do
    union = FlatBuffer.object_offset(bytes, field, 3)
    if union && FlatBuffer.read_number(bytes, union, 0, :i16, 0) == 1, do: 2, else: 1
  end

  defp buffer_count(_kind, _bytes, _field), do: 2

  defp view_count(kind) when kind in [23, 24], do: 1
  defp view_count(_kind), do: 0

  defp decode_type(bytes, field) do
    case {FlatBuffer.read_number(bytes, field, 2, :u8, 0),
          FlatBuffer.object_offset(bytes, field, 3)} do
      {1, _} -> :null
      {4, _} -> {:bytes, 32}
      {5, _} -> {:text, 32}
      {6, _} -> :boolean
      {12, _} -> {:list, 32}
      {13, _} -> :struct
      {17, _} -> :map
      {21, _} -> {:list, 64}
      {19, _} -> {:bytes, 64}
      {20, _} -> {:text, 64}
      {23, _} -> {:view, :bytes}
      {24, _} -> {:view, :text}
      {_, nil} -> :unknown
      {kind, type} -> decode_number_type(bytes, kind, type)
    end
  end

  defp decode_number_type(bytes, 2, type) do
    bits = FlatBuffer.read_number(bytes, type, 0, :i32, 0)

    if bits in [8, 16, 32, 64],
      do: {:integer, bits, FlatBuffer.read_number(bytes, type, 1, :u8, 0) == 1},
      else: :unknown
  end

  defp decode_number_type(bytes, 3, type) do
    case FlatBuffer.read_number(bytes, type, 0, :i16, 0) do
      precision when precision in 0..2 -> {:float, elem({16, 32, 64}, precision)}
      _ -> :unknown
    end
  end

  defp decode_number_type(bytes, 7, type) do
    scale = FlatBuffer.read_number(bytes, type, 1, :i32, 0)
    bits = FlatBuffer.read_number(bytes, type, 2, :i32, 128)
    if scale in 0..76 and bits in [32, 64, 128, 256], do: {:decimal, bits, scale}, else: :unknown
  end

  # Dates are stored as days or as milliseconds.
  defp decode_number_type(bytes, 8, type) do
    if FlatBuffer.read_number(bytes, type, 0, :i16, 1) == 0,
      do: {:times, 32, 86_400_000_000_000, false},
      else: {:times, 64, 1_000_000, false}
  end

  # Times of day are 32 or 64 bits wide.
  defp decode_number_type(bytes, 9, type) do
    bits = FlatBuffer.read_number(bytes, type, 1, :i32, 32)
    if bits in [32, 64], do: decode_time_type(bytes, type, bits, 1, false), else: :unknown
  end

  defp decode_number_type(bytes, 10, type), do: decode_time_type(bytes, type, 64, 0, true)
  defp decode_number_type(bytes, 18, type), do: decode_time_type(bytes, type, 64, 1, false)

  defp decode_number_type(bytes, 15, type) do
    case FlatBuffer.read_number(bytes, type, 0, :i32, 0) do
      size when size in 1..1_048_576 -> {:fixed, size}
      _ -> :unknown
    end
  end

  defp decode_number_type(bytes, 16, type) do
    case FlatBuffer.read_number(bytes, type, 0, :i32, 0) do
      size when size in 1..1_048_576 -> {:lists, size}
      _ -> :unknown
    end
  end

  defp decode_number_type(_bytes, _other, _type), do: :unknown

  defp decode_time_type(bytes, type, bits, default, time?) do
    case @nanoseconds[FlatBuffer.read_number(bytes, type, 0, :i16, default)] do
      nil -> :unknown
      factor -> {:times, bits, factor, time?}
    end
  end
end

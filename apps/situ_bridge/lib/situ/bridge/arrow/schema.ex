defmodule Situ.Bridge.Arrow.Schema do
  @moduledoc false
  # The fields of an Arrow file (Schema.fbs): written from columns, and read as what each column holds and where its
  # buffers are in a batch. Pure. Throws `{:not_arrow, why}`.
  alias Situ.Bridge.Arrow.FlatBuffer
  alias Situ.Bridge.Columnar.Column

  @deepest 64
  @nanoseconds %{0 => 1_000_000_000, 1 => 1_000_000, 2 => 1_000, 3 => 1}

  @typedoc """
  A column that can be read: `node`, `buffer` and `view` count the nodes, buffers and string views before it in a batch;
  `dictionary` is its number where values are numbers of entries (of the type `index`). Lists, maps and structs have
  `children`.
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

  @doc "The schema of these columns."
  @spec encode([Column.t()]) :: FlatBuffer.t()
  def encode(columns),
    do: {:table, [{0, {:i16, 0}}, {1, {:ref, {:vector, Enum.map(columns, &field/1)}}}]}

  defp field(column) do
    {number, fields} = type(column.kind)

    {:table,
     [
       {0, {:ref, {:string, column.name}}},
       {1, {:bool, column.optional?}},
       {2, {:u8, number}},
       {3, {:ref, {:table, fields}}},
       {5, {:ref, {:vector, []}}}
     ]}
  end

  defp type(:integer), do: {2, [{0, {:i32, 64}}, {1, {:bool, true}}]}
  defp type(:float), do: {3, [{0, {:i16, 2}}]}
  defp type(:boolean), do: {6, []}
  defp type(:time), do: {10, [{0, {:i16, 3}}, {1, {:ref, {:string, "UTC"}}}]}
  defp type(:bytes), do: {19, []}
  defp type(:text), do: {20, []}

  @doc "The columns that can be read, the names of the others, and the types of dictionaries by their numbers."
  @spec decode(binary(), non_neg_integer()) :: {[column()], [String.t()], %{integer() => term()}}
  def decode(bytes, schema) do
    if FlatBuffer.number(bytes, schema, 0, :i16, 0) != 0,
      do: throw({:not_arrow, "its numbers have their highest byte first"})

    {found, _places} =
      bytes
      |> FlatBuffer.tables(schema, 1)
      |> Enum.map_reduce({0, 0, 0}, &column(bytes, &1, &2, 0))

    columns = for {:ok, column} <- found, do: column
    nested = for {:nested, name} <- found, do: name
    {columns, nested, columns |> Enum.flat_map(&entries/1) |> Map.new()}
  end

  defp entries(%{dictionary: nil, children: children}), do: Enum.flat_map(children, &entries/1)
  defp entries(column), do: [{column.dictionary, column.type}]

  defp column(_bytes, _field, _place, depth) when depth > @deepest,
    do: throw({:not_arrow, "its fields are too deep"})

  defp column(bytes, field, {node, buffer, view} = place, depth) do
    name = FlatBuffer.string(bytes, field, 0) || ""
    type = type(bytes, field)
    {id, index} = dictionary(bytes, field)
    place_behind = behind(bytes, field, place, 0)
    children = if id == nil, do: children(type, bytes, field, place, depth), else: []

    if type == :nested or index == :nested or children == :nested or
         (id != nil and nests?(type)) do
      {{:nested, name}, place_behind}
    else
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

      {{:ok, column}, place_behind}
    end
  end

  # The columns in a list, a map or a struct: the places of the first begin behind its own buffers.
  defp children(type, bytes, field, {node, buffer, view}, depth) do
    if nests?(type) do
      kind = FlatBuffer.number(bytes, field, 2, :u8, 0)
      place = {node + 1, buffer + buffers(kind, bytes, field), view}

      {found, _} =
        bytes
        |> FlatBuffer.tables(field, 5)
        |> Enum.map_reduce(place, &column(bytes, &1, &2, depth + 1))

      fitting(type, for({:ok, column} <- found, do: column), length(found))
    else
      []
    end
  end

  defp fitting(:struct, [_ | _] = children, n) when length(children) == n, do: children
  defp fitting(:map, [%{type: :struct, children: [_, _]}] = children, 1), do: children
  defp fitting({_list, _}, [_] = children, 1), do: children
  defp fitting(_type, _children, _n), do: :nested

  defp nests?(type), do: type in [:struct, :map] or match?({l, _} when l in [:list, :lists], type)

  defp dictionary(bytes, field) do
    case FlatBuffer.object(bytes, field, 4) do
      nil ->
        {nil, nil}

      encoding ->
        index = FlatBuffer.object(bytes, encoding, 1)
        type = if index, do: number_type(bytes, 2, index), else: {:integer, 32, true}
        {FlatBuffer.number(bytes, encoding, 0, :i64, 0), type}
    end
  end

  # Nodes, buffers and string views, counted behind a field and all that is in it.
  defp behind(_bytes, _field, _place, depth) when depth > @deepest,
    do: throw({:not_arrow, "its fields are too deep"})

  defp behind(bytes, field, {node, buffer, view}, depth) do
    kind = FlatBuffer.number(bytes, field, 2, :u8, 0)

    if FlatBuffer.object(bytes, field, 4) do
      {node + 1, buffer + 2, view}
    else
      place = {node + 1, buffer + buffers(kind, bytes, field), view + views(kind)}

      bytes
      |> FlatBuffer.tables(field, 5)
      |> Enum.reduce(place, &behind(bytes, &1, &2, depth + 1))
    end
  end

  # Null and run-end encoded have none; structs and lists of one size have the presence only.
  defp buffers(kind, _bytes, _field) when kind in [1, 22], do: 0
  defp buffers(kind, _bytes, _field) when kind in [13, 16], do: 1
  defp buffers(kind, _bytes, _field) when kind in [4, 5, 19, 20, 25, 26], do: 3

  defp buffers(14, bytes, field) do
    union = FlatBuffer.object(bytes, field, 3)
    if union && FlatBuffer.number(bytes, union, 0, :i16, 0) == 1, do: 2, else: 1
  end

  defp buffers(_kind, _bytes, _field), do: 2

  defp views(kind) when kind in [23, 24], do: 1
  defp views(_kind), do: 0

  defp type(bytes, field) do
    case {FlatBuffer.number(bytes, field, 2, :u8, 0), FlatBuffer.object(bytes, field, 3)} do
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
      {_, nil} -> :nested
      {kind, type} -> number_type(bytes, kind, type)
    end
  end

  defp number_type(bytes, 2, type) do
    bits = FlatBuffer.number(bytes, type, 0, :i32, 0)

    if bits in [8, 16, 32, 64],
      do: {:integer, bits, FlatBuffer.number(bytes, type, 1, :u8, 0) == 1},
      else: :nested
  end

  defp number_type(bytes, 3, type) do
    case FlatBuffer.number(bytes, type, 0, :i16, 0) do
      precision when precision in 0..2 -> {:float, elem({16, 32, 64}, precision)}
      _ -> :nested
    end
  end

  defp number_type(bytes, 7, type) do
    scale = FlatBuffer.number(bytes, type, 1, :i32, 0)
    bits = FlatBuffer.number(bytes, type, 2, :i32, 128)
    if scale in 0..76 and bits in [32, 64, 128, 256], do: {:decimal, bits, scale}, else: :nested
  end

  # Days, or milliseconds.
  defp number_type(bytes, 8, type) do
    if FlatBuffer.number(bytes, type, 0, :i16, 1) == 0,
      do: {:times, 32, 86_400_000_000_000, false},
      else: {:times, 64, 1_000_000, false}
  end

  # The time of a day.
  defp number_type(bytes, 9, type) do
    bits = FlatBuffer.number(bytes, type, 1, :i32, 32)
    if bits in [32, 64], do: times(bytes, type, bits, 1, false), else: :nested
  end

  defp number_type(bytes, 10, type), do: times(bytes, type, 64, 0, true)
  defp number_type(bytes, 18, type), do: times(bytes, type, 64, 1, false)

  defp number_type(bytes, 15, type) do
    case FlatBuffer.number(bytes, type, 0, :i32, 0) do
      size when size in 1..1_048_576 -> {:fixed, size}
      _ -> :nested
    end
  end

  defp number_type(bytes, 16, type) do
    case FlatBuffer.number(bytes, type, 0, :i32, 0) do
      size when size in 1..1_048_576 -> {:lists, size}
      _ -> :nested
    end
  end

  defp number_type(_bytes, _other, _type), do: :nested

  defp times(bytes, type, bits, default, time?) do
    case @nanoseconds[FlatBuffer.number(bytes, type, 0, :i16, default)] do
      nil -> :nested
      factor -> {:times, bits, factor, time?}
    end
  end
end

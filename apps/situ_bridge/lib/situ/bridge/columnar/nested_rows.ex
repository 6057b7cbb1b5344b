defmodule Situ.Bridge.Columnar.NestedRows do
  @moduledoc false
  # Converts the data of messages into rows of columns that may be nested: maps and structs become structs, and lists
  # and tuples become lists. Values of the same member with different types are written as JSON. Pure.
  alias Situ.Bridge.Columnar.{Cell, Column}
  alias Situ.Columns

  @typedoc "The kind of a value; `nil` if only missing values are known."
  @type kind :: Column.kind() | nil | {:list, kind()} | {:struct, %{String.t() => kind()}}
  @max_columns 1_000

  @doc "Merges the kinds of another part of a stream into the kinds of the columns."
  @spec merge_part_kinds(%{String.t() => kind()}, Columns.t() | [Situ.Message.t()]) :: %{
          String.t() => kind()
        }
  def merge_part_kinds(kinds, %Columns{kind: kind}), do: merge_columns(kinds, %{"value" => kind})

  def merge_part_kinds(kinds, messages),
    do: Enum.reduce(messages, kinds, &merge_columns(&2, data_kinds(&1.data)))

  defp merge_columns(kinds, others) do
    kinds = Map.merge(kinds, others, fn _name, a, b -> common_kind(a, b) end)
    if map_size(kinds) > @max_columns, do: throw({:not_writable, :too_many_columns}), else: kinds
  end

  defp data_kinds(data) do
    case value_kind(data) do
      {:struct, members} -> members
      kind -> %{"value" => kind}
    end
  end

  defp value_kind(%_{} = struct), do: struct |> Map.from_struct() |> value_kind()

  defp value_kind(map) when map_size(map) > 0,
    do: {:struct, Map.new(map, fn {key, value} -> {Cell.member_name(key), value_kind(value)} end)}

  defp value_kind(tuple) when is_tuple(tuple), do: tuple |> Tuple.to_list() |> value_kind()

  defp value_kind(list) when is_list(list),
    do: {:list, Enum.reduce(list, nil, &common_kind(&2, value_kind(&1)))}

  defp value_kind(value), do: Cell.value_kind(value)

  defp common_kind(same, same), do: same
  defp common_kind(nil, kind), do: kind
  defp common_kind(kind, nil), do: kind
  defp common_kind({:list, a}, {:list, b}), do: {:list, common_kind(a, b)}

  defp common_kind({:struct, a}, {:struct, b}),
    do: {:struct, Map.merge(a, b, fn _name, a, b -> common_kind(a, b) end)}

  defp common_kind(a, b) when is_tuple(a) or is_tuple(b), do: :text
  defp common_kind(a, b), do: Cell.common_kind(a, b)

  @doc "Returns the columns that follow the times, sorted by name. Values that are always missing have the type text."
  @spec build_columns(%{String.t() => kind()}) :: [Column.t()]
  def build_columns(kinds),
    do: for({name, kind} <- Enum.sort(kinds), do: %Column{name: name, kind: complete_kind(kind)})

  defp complete_kind(nil), do: :text
  defp complete_kind({:list, kind}), do: {:list, complete_kind(kind)}

  defp complete_kind({:struct, members}),
    do: {:struct, for({name, kind} <- Enum.sort(members), do: {name, complete_kind(kind)})}

  defp complete_kind(kind), do: kind

  @doc "Returns the rows of messages: their times, and the values of these columns."
  @spec build_rows([Situ.Message.t()], [Column.t()]) :: [[term()]]
  def build_rows(messages, columns) do
    for message <- messages,
        do: [message.originating_time, message.creation_time | row_values(message.data, columns)]
  end

  @doc "Returns the values of a message for these columns. The members of a struct are a tuple."
  @spec row_values(term(), [Column.t()]) :: [term()]
  def row_values(data, columns) do
    members = Enum.map(columns, &{&1.name, &1.kind})

    case plain_value(data) do
      map when is_map(map) and map_size(map) > 0 -> member_values(map, members)
      value -> member_values(%{"value" => value}, members)
    end
  end

  defp plain_value(%_{} = struct), do: Map.from_struct(struct)
  defp plain_value(tuple) when is_tuple(tuple), do: Tuple.to_list(tuple)
  defp plain_value(value), do: value

  defp member_values(map, members) do
    values = Map.new(map, fn {key, value} -> {Cell.member_name(key), value} end)
    for {name, kind} <- members, do: convert_value(plain_value(values[name]), kind)
  end

  defp convert_value(nil, _kind), do: nil

  defp convert_value(list, {:list, kind}),
    do: Enum.map(list, &convert_value(plain_value(&1), kind))

  defp convert_value(map, {:struct, members}),
    do: map |> member_values(members) |> List.to_tuple()

  defp convert_value(value, kind), do: Cell.convert_value(value, kind)
end

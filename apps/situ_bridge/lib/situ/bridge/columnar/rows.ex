defmodule Situ.Bridge.Columnar.Rows do
  @moduledoc false
  # Converts the data of messages into rows of flat columns: one column for a plain value, or one for each member of
  # maps and structs, with nested members named `a.b`. Lists and other values that are not numbers, booleans, strings
  # or bytes are written as JSON. Pure.
  alias Situ.Bridge.Columnar.{Cell, Column, Shape}
  alias Situ.Columns

  @max_columns 1_000

  @type kinds :: %{String.t() => Column.kind() | nil}

  @doc "Merges the kinds of another part of a stream into the kinds of the columns."
  @spec merge_part_kinds(kinds(), Columns.t() | [Situ.Message.t()]) :: kinds()
  def merge_part_kinds(kinds, %Columns{kind: kind}), do: merge_kind(kinds, "value", kind)

  def merge_part_kinds(kinds, messages), do: merge_messages(messages, kinds, nil)

  defp merge_messages([%{data: data} | messages], kinds, shape) do
    if shape != nil and Shape.same_kinds?(data, shape) do
      merge_messages(messages, kinds, shape)
    else
      kinds = merge_data_kinds(kinds, data)
      merge_messages(messages, kinds, Shape.build_kinds(data, kinds))
    end
  end

  defp merge_messages([], kinds, _shape), do: kinds

  @doc "Merges the kinds of another message's data into the kinds of the columns."
  @spec merge_data_kinds(kinds(), term()) :: kinds()
  def merge_data_kinds(kinds, data) do
    data
    |> flatten_data()
    |> Enum.reduce(kinds, fn {name, value}, kinds ->
      merge_kind(kinds, name, Cell.value_kind(value))
    end)
  end

  defp merge_kind(kinds, name, kind) do
    case kinds do
      %{^name => current} -> put_kind(kinds, name, current, Cell.common_kind(current, kind))
      _ when map_size(kinds) >= @max_columns -> throw({:not_writable, :too_many_columns})
      _ -> Map.put(kinds, name, kind)
    end
  end

  defp put_kind(kinds, _name, same, same), do: kinds
  defp put_kind(kinds, name, _current, merged), do: Map.put(kinds, name, merged)

  @doc "Returns the columns that follow the times, sorted by name. A column without any values has the type text."
  @spec build_columns(kinds()) :: [Column.t()]
  def build_columns(kinds) do
    for {name, kind} <- Enum.sort(kinds), do: %Column{name: name, kind: kind || :text}
  end

  @doc "Returns the rows of messages: their times, and the values of these columns."
  @spec build_rows([Situ.Message.t()], [Column.t()]) :: [[term()]]
  def build_rows(messages, columns) do
    {rows, _plan} =
      Enum.map_reduce(messages, nil, fn %{data: data} = message, plan ->
        {values, plan} = planned_values(data, columns, plan)
        {[message.originating_time, message.creation_time | values], plan}
      end)

    rows
  end

  defp planned_values(data, columns, {keys, paths} = plan) do
    if Shape.same_keys?(data, keys),
      do:
        {for({path, kind} <- paths, do: Cell.convert_value(Shape.value_at(data, path), kind)),
         plan},
      else: planned_values(data, columns, nil)
  end

  defp planned_values(data, columns, nil),
    do: {row_values(data, columns), Shape.build_plan(data, columns)}

  @doc "Returns the values of a message for these columns."
  @spec row_values(term(), [Column.t()]) :: [term()]
  def row_values(data, [%Column{name: "value"} = column]) when not is_map(data),
    do: [Cell.convert_value(data, column.kind)]

  def row_values(data, columns) do
    values = data |> flatten_data() |> Map.new()
    for %{name: name, kind: kind} <- columns, do: Cell.convert_value(values[name], kind)
  end

  defp flatten_data(%_{} = struct), do: struct |> Map.from_struct() |> flatten_members("")
  defp flatten_data(map) when is_map(map), do: flatten_members(map, "")
  defp flatten_data(value), do: [{"value", value}]

  defp flatten_members(map, prefix) do
    Enum.flat_map(map, fn {key, value} ->
      name = prefix <> Cell.member_name(key)

      case value do
        %_{} = struct -> struct |> Map.from_struct() |> flatten_members(name <> ".")
        map when is_map(map) and map_size(map) > 0 -> flatten_members(map, name <> ".")
        value -> [{name, value}]
      end
    end)
  end
end

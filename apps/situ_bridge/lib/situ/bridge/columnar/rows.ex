defmodule Situ.Bridge.Columnar.Rows do
  @moduledoc false
  # Converts the data of messages into rows of flat columns: one column for a plain value, or one for each member of
  # maps and structs, with nested members named `a.b`. Lists and other values that are not numbers, booleans, strings
  # or bytes are written as JSON. Pure.
  alias Situ.Bridge.Columnar.Column
  alias Situ.Bridge.Format.Value
  alias Situ.Columns

  @special_floats [:nan, :infinity, :neg_infinity]
  @max_columns 1_000

  @type kinds :: %{String.t() => Column.kind() | nil}

  @doc "Merges the kinds of another part of a stream into the kinds of the columns."
  @spec merge_part_kinds(kinds(), Columns.t() | [Situ.Message.t()]) :: kinds()
  def merge_part_kinds(kinds, %Columns{kind: kind}), do: merge_kind(kinds, "value", kind)

  def merge_part_kinds(kinds, messages),
    do: Enum.reduce(messages, kinds, &merge_data_kinds(&2, &1.data))

  @doc "Merges the kinds of another message's data into the kinds of the columns."
  @spec merge_data_kinds(kinds(), term()) :: kinds()
  def merge_data_kinds(kinds, data) do
    data
    |> flatten_data()
    |> Enum.reduce(kinds, fn {name, value}, kinds ->
      merge_kind(kinds, name, value_kind(value))
    end)
  end

  defp merge_kind(kinds, name, kind) do
    case kinds do
      %{^name => current} -> put_kind(kinds, name, current, common_kind(current, kind))
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

  @doc "Returns the values of a message for these columns."
  @spec row_values(term(), [Column.t()]) :: [term()]
  def row_values(data, [%Column{name: "value"} = column]) when not is_map(data),
    do: [cell_value(data, column.kind)]

  def row_values(data, columns) do
    values = data |> flatten_data() |> Map.new()
    for %{name: name, kind: kind} <- columns, do: cell_value(values[name], kind)
  end

  defp cell_value(nil, _kind), do: nil
  defp cell_value(n, kind) when kind == :integer and is_integer(n), do: n
  defp cell_value(x, :float) when is_number(x) or x in @special_floats, do: x
  defp cell_value(b, :boolean) when is_boolean(b), do: b
  defp cell_value(bytes, kind) when kind in [:text, :bytes] and is_binary(bytes), do: bytes
  defp cell_value(value, _kind), do: value |> Value.to_plain() |> Situ.JSON.encode()

  defp value_kind(nil), do: nil
  defp value_kind(b) when is_boolean(b), do: :boolean

  defp value_kind(n) when is_integer(n) and n in -0x8000000000000000..0x7FFFFFFFFFFFFFFF,
    do: :integer

  defp value_kind(x) when is_float(x) or x in @special_floats, do: :float

  defp value_kind(bytes) when is_binary(bytes),
    do: if(String.valid?(bytes), do: :text, else: :bytes)

  defp value_kind(_other), do: :text

  defp common_kind(same, same), do: same
  defp common_kind(nil, kind), do: kind
  defp common_kind(kind, nil), do: kind
  defp common_kind(:integer, :float), do: :float
  defp common_kind(:float, :integer), do: :float
  defp common_kind(:text, :bytes), do: :bytes
  defp common_kind(:bytes, :text), do: :bytes
  defp common_kind(_, _), do: :text

  defp flatten_data(%_{} = struct), do: struct |> Map.from_struct() |> flatten_members("")
  defp flatten_data(map) when is_map(map), do: flatten_members(map, "")
  defp flatten_data(value), do: [{"value", value}]

  defp flatten_members(map, prefix) do
    Enum.flat_map(map, fn {key, value} ->
      name = prefix <> member_name(key)

      case value do
        %_{} = struct -> struct |> Map.from_struct() |> flatten_members(name <> ".")
        map when is_map(map) and map_size(map) > 0 -> flatten_members(map, name <> ".")
        value -> [{name, value}]
      end
    end)
  end

  defp member_name(key) when is_binary(key),
    do: if(String.valid?(key), do: key, else: inspect(key))

  defp member_name(key) when is_atom(key), do: Atom.to_string(key)
  defp member_name(key), do: inspect(key)
end

defmodule Situ.Bridge.Columnar.Rows do
  @moduledoc false
  # Converts the data of messages into rows of flat columns: one column for a plain value, or one for each member of
  # maps and structs, with nested members named `a.b`. Lists and other values that are not numbers, booleans, strings
  # or bytes are written as JSON. Pure.
  alias Situ.Bridge.Columnar.Column
  alias Situ.Bridge.Format.Value
  alias Situ.Store.Columns

  @special [:nan, :infinity, :neg_infinity]
  @most_columns 1_000

  @type kinds :: %{String.t() => Column.kind() | nil}

  @doc "Merges the kinds of another part of a stream into the kinds of the columns."
  @spec part(kinds(), Columns.t() | [Situ.Message.t()]) :: kinds()
  def part(kinds, %Columns{kind: kind}), do: merge(kinds, "value", kind)
  def part(kinds, messages), do: Enum.reduce(messages, kinds, &add(&2, &1.data))

  @doc "Merges the kinds of another message's data into the kinds of the columns."
  @spec add(kinds(), term()) :: kinds()
  def add(kinds, data) do
    data
    |> flat()
    |> Enum.reduce(kinds, fn {name, value}, kinds -> merge(kinds, name, kind(value)) end)
  end

  defp merge(kinds, name, kind) do
    case kinds do
      %{^name => known} -> put(kinds, name, known, wider(known, kind))
      _ when map_size(kinds) >= @most_columns -> throw({:not_writable, :too_many_columns})
      _ -> Map.put(kinds, name, kind)
    end
  end

  defp put(kinds, _name, same, same), do: kinds
  defp put(kinds, name, _known, wider), do: Map.put(kinds, name, wider)

  @doc "Returns the columns that follow the times, sorted by name. A column that never had a value is text."
  @spec columns(kinds()) :: [Column.t()]
  def columns(kinds) do
    for {name, kind} <- Enum.sort(kinds), do: %Column{name: name, kind: kind || :text}
  end

  @doc "Returns the values of a message for these columns."
  @spec row(term(), [Column.t()]) :: [term()]
  def row(data, [%Column{name: "value"} = column]) when not is_map(data),
    do: [cell(data, column.kind)]

  def row(data, columns) do
    values = data |> flat() |> Map.new()
    for %{name: name, kind: kind} <- columns, do: cell(values[name], kind)
  end

  defp cell(nil, _kind), do: nil
  defp cell(n, kind) when kind == :integer and is_integer(n), do: n
  defp cell(x, :float) when is_number(x) or x in @special, do: x
  defp cell(b, :boolean) when is_boolean(b), do: b
  defp cell(bytes, kind) when kind in [:text, :bytes] and is_binary(bytes), do: bytes
  defp cell(value, _kind), do: value |> Value.plain() |> Situ.JSON.encode()

  defp kind(nil), do: nil
  defp kind(b) when is_boolean(b), do: :boolean
  defp kind(n) when is_integer(n) and n in -0x8000000000000000..0x7FFFFFFFFFFFFFFF, do: :integer
  defp kind(x) when is_float(x) or x in @special, do: :float
  defp kind(bytes) when is_binary(bytes), do: if(String.valid?(bytes), do: :text, else: :bytes)
  defp kind(_other), do: :text

  defp wider(same, same), do: same
  defp wider(nil, kind), do: kind
  defp wider(kind, nil), do: kind
  defp wider(:integer, :float), do: :float
  defp wider(:float, :integer), do: :float
  defp wider(:text, :bytes), do: :bytes
  defp wider(:bytes, :text), do: :bytes
  defp wider(_, _), do: :text

  defp flat(%_{} = struct), do: struct |> Map.from_struct() |> members("")
  defp flat(map) when is_map(map), do: members(map, "")
  defp flat(value), do: [{"value", value}]

  defp members(map, prefix) do
    Enum.flat_map(map, fn {key, value} ->
      name = prefix <> name(key)

      case value do
        %_{} = struct -> struct |> Map.from_struct() |> members(name <> ".")
        map when is_map(map) and map_size(map) > 0 -> members(map, name <> ".")
        value -> [{name, value}]
      end
    end)
  end

  defp name(key) when is_binary(key), do: if(String.valid?(key), do: key, else: inspect(key))
  defp name(key) when is_atom(key), do: Atom.to_string(key)
  defp name(key), do: inspect(key)
end

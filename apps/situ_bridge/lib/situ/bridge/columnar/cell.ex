defmodule Situ.Bridge.Columnar.Cell do
  @moduledoc false
  # The kinds of values in columns, and their conversion to the kind of a column. Pure.
  alias Situ.Bridge.Columnar.Column
  alias Situ.Bridge.Format.Value

  @special_floats [:nan, :infinity, :neg_infinity]

  @doc "Returns a value for a column of a kind: JSON if it has another kind."
  @spec convert_value(term(), Column.kind()) :: term()
  def convert_value(nil, _kind), do: nil
  def convert_value(x, :float) when is_float(x), do: x
  def convert_value(n, kind) when kind == :integer and is_integer(n), do: n
  def convert_value(x, :float) when is_number(x) or x in @special_floats, do: x
  def convert_value(b, :boolean) when is_boolean(b), do: b
  def convert_value(bytes, kind) when kind in [:text, :bytes] and is_binary(bytes), do: bytes
  def convert_value(value, _kind), do: value |> Value.to_plain() |> Situ.JSON.encode()

  @doc "Returns the kind of a column after another value."
  @spec merge_value(Column.kind() | nil, term()) :: Column.kind() | nil
  def merge_value(kind, value), do: common_kind(kind, value_kind(value))

  @doc "Returns the kind of a value, or `nil` if it is missing."
  @spec value_kind(term()) :: Column.kind() | nil
  def value_kind(nil), do: nil
  def value_kind(b) when is_boolean(b), do: :boolean

  def value_kind(n) when is_integer(n) and n in -0x8000000000000000..0x7FFFFFFFFFFFFFFF,
    do: :integer

  def value_kind(x) when is_float(x) or x in @special_floats, do: :float

  def value_kind(bytes) when is_binary(bytes),
    do: if(String.valid?(bytes), do: :text, else: :bytes)

  def value_kind(_other), do: :text

  @doc "Returns the kind of a column with values of both kinds."
  @spec common_kind(Column.kind() | nil, Column.kind() | nil) :: Column.kind() | nil
  def common_kind(same, same), do: same
  def common_kind(nil, kind), do: kind
  def common_kind(kind, nil), do: kind
  def common_kind(:integer, :float), do: :float
  def common_kind(:float, :integer), do: :float
  def common_kind(:text, :bytes), do: :bytes
  def common_kind(:bytes, :text), do: :bytes
  def common_kind(_, _), do: :text

  @doc "Returns the name of a map's key."
  @spec member_name(term()) :: String.t()
  def member_name(key) when is_binary(key),
    do: if(String.valid?(key), do: key, else: inspect(key))

  def member_name(key) when is_atom(key), do: Atom.to_string(key)
  def member_name(key), do: inspect(key)
end

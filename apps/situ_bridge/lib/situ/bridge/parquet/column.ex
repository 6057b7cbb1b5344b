defmodule Situ.Bridge.Parquet.Column do
  @moduledoc false
  # Encodes a column for Parquet: its schema element, and its values (encoding PLAIN, with definition levels if values
  # may be missing). Pure.
  import Bitwise
  alias Situ.Bridge.Columnar.Column
  alias Situ.Bridge.Parquet.Thrift

  # Parquet's physical types.
  @physical_types %{time: 2, integer: 2, float: 5, boolean: 0, text: 6, bytes: 6}
  @doc "Returns the number of the column's physical type."
  @spec physical_type(Column.t()) :: non_neg_integer()
  def physical_type(column), do: @physical_types[column.kind]

  @doc "Returns the column's element of the file's schema."
  @spec schema_element(Column.t()) :: {:struct, list()}
  def schema_element(column) do
    logical =
      case column.kind do
        :time ->
          [
            {10,
             struct_term([
               {8, struct_term([{1, {:bool, true}}, {2, struct_term([{3, struct_term([])}])}])}
             ])}
          ]

        :text ->
          [{6, {:i32, 0}}, {10, struct_term([{1, struct_term([])}])}]

        _ ->
          []
      end

    struct_term([
      {1, {:i32, physical_type(column)}},
      {3, {:i32, if(column.optional?, do: 1, else: 0)}},
      {4, {:binary, column.name}} | logical
    ])
  end

  defp struct_term(fields), do: {:struct, fields}

  @doc "Encodes the body of a page: the levels and the values."
  @spec encode_page(Column.t(), Column.values()) :: iodata()
  def encode_page(%{optional?: false}, {:bytes, bytes, _n}), do: bytes

  def encode_page(column, {:bytes, bytes, n}) do
    levels = encode_levels([], n, n)
    [<<IO.iodata_length(levels)::little-32>>, levels, Column.pack_bytes(column.kind, bytes)]
  end

  def encode_page(%{optional?: false} = column, values), do: encode_plain(column.kind, values)

  def encode_page(column, values) do
    present = Enum.reject(values, &is_nil/1)
    levels = encode_levels(values, length(values), length(present))
    [<<IO.iodata_length(levels)::little-32>>, levels, encode_plain(column.kind, present)]
  end

  # If no value is missing, the levels are one run. Otherwise each level is one bit, in groups of eight.
  defp encode_levels(_values, n, n), do: [Thrift.encode_varint(n <<< 1), 1]

  defp encode_levels(values, n, _present),
    do: [Thrift.encode_varint(div(n + 7, 8) <<< 1 ||| 1), Column.presence_bits(values)]

  defp encode_plain(kind, values) when kind in [:text, :bytes],
    do: for(text <- values, do: [<<byte_size(text)::little-32>>, text])

  defp encode_plain(kind, values), do: Column.pack_values(kind, values)
end

defmodule Situ.Bridge.Parquet.Column do
  @moduledoc false
  # Encodes a column for Parquet: its schema element, and its values (encoding PLAIN, with definition levels if values
  # may be missing). Pure.
  import Bitwise
  alias Situ.Bridge.Columnar.Column
  alias Situ.Bridge.Parquet.Thrift

  # Parquet's physical types.
  @physical %{time: 2, integer: 2, float: 5, boolean: 0, text: 6, bytes: 6}
  @doc "Returns the number of the column's physical type."
  @spec physical(Column.t()) :: non_neg_integer()
  def physical(column), do: @physical[column.kind]

  @doc "Returns the column's element of the file's schema."
  @spec element(Column.t()) :: {:struct, list()}
  def element(column) do
    logical =
      case column.kind do
        :time ->
          [{10, record([{8, record([{1, {:bool, true}}, {2, record([{3, record([])}])}])}])}]

        :text ->
          [{6, {:i32, 0}}, {10, record([{1, record([])}])}]

        _ ->
          []
      end

    record([
      {1, {:i32, physical(column)}},
      {3, {:i32, if(column.optional?, do: 1, else: 0)}},
      {4, {:binary, column.name}} | logical
    ])
  end

  defp record(fields), do: {:struct, fields}

  @doc "Encodes the body of a page: the levels and the values."
  @spec page(Column.t(), Column.values()) :: iodata()
  def page(%{optional?: false}, {:bytes, bytes, _n}), do: bytes

  def page(column, {:bytes, bytes, n}) do
    levels = levels([], n, n)
    [<<IO.iodata_length(levels)::little-32>>, levels, Column.pack_bytes(column.kind, bytes)]
  end

  def page(%{optional?: false} = column, values), do: plain(column.kind, values)

  def page(column, values) do
    there = Enum.reject(values, &is_nil/1)
    levels = levels(values, length(values), length(there))
    [<<IO.iodata_length(levels)::little-32>>, levels, plain(column.kind, there)]
  end

  # If no value is missing, the levels are one run. Otherwise each level is one bit, in groups of eight.
  defp levels(_values, n, n), do: [Thrift.varint(n <<< 1), 1]

  defp levels(values, n, _there),
    do: [Thrift.varint(div(n + 7, 8) <<< 1 ||| 1), Column.presence(values)]

  defp plain(kind, values) when kind in [:text, :bytes],
    do: for(text <- values, do: [<<byte_size(text)::little-32>>, text])

  defp plain(kind, values), do: Column.pack(kind, values)
end

defmodule Situ.Bridge.Parquet.Writer do
  @moduledoc false
  # Writes a Parquet file (https://github.com/apache/parquet-format): row groups with one page per column, and the
  # footer.
  @behaviour Situ.Bridge.Columnar.Writer
  alias Situ.Bridge.Columnar.Output
  alias Situ.Bridge.Parquet.{Column, Thrift}

  @codecs %{none: 0, gzip: 2}

  defstruct [:output, :columns, :codec, rows: 0, groups: []]
  @type t :: %__MODULE__{}

  @impl true
  def create(path, columns, codec) do
    with {:ok, output} <- Output.create_file(path, "PAR1"),
         do: {:ok, %__MODULE__{output: output, columns: columns, codec: codec}}
  end

  @impl true
  def write(%{output: %{at: from}} = writer, values, rows) do
    {chunks, at} =
      writer.columns
      |> Enum.zip(values)
      |> Enum.map_reduce(from, fn {column, values}, at ->
        {bytes, meta} = encode_chunk(column, values, rows, at, writer.codec)
        {{bytes, meta}, at + IO.iodata_length(bytes)}
      end)

    with {:ok, output} <- Output.append_bytes(writer.output, Enum.map(chunks, &elem(&1, 0))) do
      group =
        {:struct,
         [
           {1, {:list, Enum.map(chunks, &elem(&1, 1))}},
           {2, {:i64, at - from}},
           {3, {:i64, rows}}
         ]}

      {:ok, %{writer | output: output, rows: writer.rows + rows, groups: [group | writer.groups]}}
    end
  end

  defp encode_chunk(column, values, rows, at, codec) do
    body = Column.encode_page(column, values)
    packed = if codec == :gzip, do: :zlib.gzip(body), else: body
    {size, stored} = {IO.iodata_length(body), IO.iodata_length(packed)}
    page = {:struct, [{1, {:i32, rows}}, {2, {:i32, 0}}, {3, {:i32, 3}}, {4, {:i32, 3}}]}

    head =
      Thrift.encode_struct(
        {:struct, [{1, {:i32, 0}}, {2, {:i32, size}}, {3, {:i32, stored}}, {5, page}]}
      )

    n = IO.iodata_length(head)

    meta = [
      {1, {:i32, Column.physical_type(column)}},
      {2, {:list, [{:i32, 0}, {:i32, 3}]}},
      {3, {:list, [{:binary, column.name}]}},
      {4, {:i32, @codecs[codec]}},
      {5, {:i64, rows}},
      {6, {:i64, n + size}},
      {7, {:i64, n + stored}},
      {9, {:i64, at}}
    ]

    {[head, packed], {:struct, [{2, {:i64, at}}, {3, {:struct, meta}}]}}
  end

  @impl true
  def finish(writer) do
    root = {:struct, [{4, {:binary, "situ"}}, {5, {:i32, length(writer.columns)}}]}

    footer =
      Thrift.encode_struct(
        {:struct,
         [
           {1, {:i32, 2}},
           {2, {:list, [root | Enum.map(writer.columns, &Column.schema_element/1)]}},
           {3, {:i64, writer.rows}},
           {4, {:list, Enum.reverse(writer.groups)}},
           {6, {:binary, "situ"}}
         ]}
      )

    tail = [footer, <<IO.iodata_length(footer)::little-32>>, "PAR1"]
    with :ok <- Output.finish_file(writer.output, tail), do: {:ok, writer.rows}
  end

  @impl true
  def abandon(writer), do: Output.delete_unfinished(writer.output)
end

defmodule Situ.Bridge.Arrow.Writer do
  @moduledoc false
  # Writes an Arrow file (https://arrow.apache.org/docs/format/Columnar.html): the schema, batches of rows, and a
  # footer with their positions.
  @behaviour Situ.Bridge.Columnar.Writer
  alias Situ.Bridge.Arrow.{FlatBuffer, Schema}
  alias Situ.Bridge.Columnar.{Column, Output}

  # The value of MetadataVersion.V5.
  @version 4

  defstruct [:output, :columns, rows: 0, blocks: []]
  @type t :: %__MODULE__{}

  @impl true
  def create(path, columns, _opts) do
    head = ["ARROW1", 0, 0, encode_message(1, Schema.encode_columns(columns), 0)]

    with {:ok, output} <- Output.create_file(path, head),
         do: {:ok, %__MODULE__{output: output, columns: columns}}
  end

  @impl true
  def max_rows(rows), do: rows

  # A message is 0xFFFFFFFF, the length and the metadata, padded together to a multiple of 8 bytes.
  defp encode_message(kind, header, body) do
    metadata =
      FlatBuffer.encode_table(
        {:table,
         [
           {0, {:i16, @version}},
           {1, {:u8, kind}},
           {2, {:ref, header}},
           {3, {:i64, body}}
         ]}
      )

    padding = padding_bytes(byte_size(metadata))
    [<<0xFFFFFFFF::32, byte_size(metadata) + byte_size(padding)::little-32>>, metadata, padding]
  end

  @impl true
  def write(writer, {:rows, list}, rows), do: write(writer, Enum.zip_with(list, & &1), rows)

  def write(writer, values, rows) do
    {columns, nodes} =
      writer.columns
      |> Enum.zip(values)
      |> Enum.map(fn {column, values} -> column_buffers(column, values, rows) end)
      |> Enum.unzip()

    {buffers, body} =
      columns
      |> Enum.concat()
      |> Enum.map_reduce(0, fn bytes, at ->
        size = IO.iodata_length(bytes)
        {{bytes, at, size}, at + size + byte_size(padding_bytes(size))}
      end)

    batch =
      {:table,
       [
         {0, {:i64, rows}},
         {1, {:ref, {:structs, for(n <- nodes, do: <<rows::little-64, n::little-64>>)}}},
         {2, {:ref, {:structs, for({_, at, n} <- buffers, do: <<at::little-64, n::little-64>>)}}}
       ]}

    head = encode_message(3, batch, body)
    bytes = for {bytes, _at, size} <- buffers, do: [bytes, padding_bytes(size)]

    block =
      <<writer.output.at::little-64, IO.iodata_length(head)::little-32, 0::32, body::little-64>>

    with {:ok, output} <- Output.append_bytes(writer.output, [head, bytes]),
         do:
           {:ok,
            %{writer | output: output, rows: writer.rows + rows, blocks: [block | writer.blocks]}}
  end

  # Returns the buffers of a column and the number of missing values.
  defp column_buffers(column, {:bytes, bytes, _n}, _rows),
    do: {["", Column.pack_bytes(column.kind, bytes)], 0}

  defp column_buffers(column, values, rows) do
    missing = Enum.count(values, &is_nil/1)
    presence = if missing == 0, do: "", else: Column.presence_bits(values)
    {[presence | pack_buffers(column.kind, values, rows)], missing}
  end

  defp pack_buffers(kind, values, _rows) when kind in [:text, :bytes] do
    {ends, _} =
      Enum.map_reduce(values, 0, fn value, at ->
        at = at + byte_size(value || "")
        {<<at::little-64>>, at}
      end)

    [[<<0::64>> | ends], Enum.map(values, &(&1 || ""))]
  end

  # Missing values take up space, too, but their content is arbitrary.
  defp pack_buffers(kind, values, _rows) do
    zero = if kind == :boolean, do: false, else: 0
    [Column.pack_values(kind, Enum.map(values, &if(&1 == nil, do: zero, else: &1)))]
  end

  @impl true
  def finish(writer) do
    footer =
      FlatBuffer.encode_table(
        {:table,
         [
           {0, {:i16, @version}},
           {1, {:ref, Schema.encode_columns(writer.columns)}},
           {2, {:ref, {:structs, []}}},
           {3, {:ref, {:structs, Enum.reverse(writer.blocks)}}}
         ]}
      )

    tail = [<<0xFFFFFFFF::32, 0::32>>, footer, <<byte_size(footer)::little-32>>, "ARROW1"]
    with :ok <- Output.finish_file(writer.output, tail), do: {:ok, writer.rows}
  end

  @impl true
  def abandon(writer), do: Output.delete_unfinished(writer.output)

  defp padding_bytes(size), do: <<0::size(rem(8 - rem(size, 8), 8) * 8)>>
end

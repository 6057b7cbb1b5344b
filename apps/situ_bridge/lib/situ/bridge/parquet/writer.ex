defmodule Situ.Bridge.Parquet.Writer do
  @moduledoc false
  # A Parquet file (https://github.com/apache/parquet-format): row groups of one page a column, then the footer. It has
  # another name until it is whole.
  alias Situ.Bridge.Parquet.{Column, Thrift}
  alias Situ.Error

  @codecs %{none: 0, gzip: 2}

  defstruct [:path, :file, :columns, :codec, at: 4, rows: 0, groups: []]
  @type t :: %__MODULE__{}

  @spec create(Path.t(), [Column.t()], :none | :gzip) :: {:ok, t()} | {:error, Error.t()}
  def create(path, columns, codec) do
    with {:ok, file} <- :file.open(unfinished(path), [:write, :raw, :binary]),
         :ok <- :file.write(file, "PAR1") do
      {:ok, %__MODULE__{path: path, file: file, columns: columns, codec: codec}}
    else
      {:error, reason} -> {:error, failed(path, reason)}
    end
  end

  defp unfinished(path), do: path <> ".unfinished"

  @doc "A row group: the values of each column."
  @spec write(t(), [[term()]], rows :: pos_integer()) :: {:ok, t()} | {:error, Error.t()}
  def write(writer, values, rows) do
    {chunks, at} =
      writer.columns
      |> Enum.zip(values)
      |> Enum.map_reduce(writer.at, fn {column, values}, at ->
        {bytes, meta} = chunk(column, values, rows, at, writer.codec)
        {{bytes, meta}, at + IO.iodata_length(bytes)}
      end)

    with :ok <- :file.write(writer.file, Enum.map(chunks, &elem(&1, 0))) do
      group =
        {:struct,
         [
           {1, {:list, Enum.map(chunks, &elem(&1, 1))}},
           {2, {:i64, at - writer.at}},
           {3, {:i64, rows}}
         ]}

      {:ok, %{writer | at: at, rows: writer.rows + rows, groups: [group | writer.groups]}}
    else
      {:error, reason} -> {:error, failed(writer.path, reason)}
    end
  end

  defp chunk(column, values, rows, at, codec) do
    body = Column.page(column, values)
    packed = if codec == :gzip, do: :zlib.gzip(body), else: body
    {size, stored} = {IO.iodata_length(body), IO.iodata_length(packed)}
    page = {:struct, [{1, {:i32, rows}}, {2, {:i32, 0}}, {3, {:i32, 3}}, {4, {:i32, 3}}]}

    head =
      Thrift.write({:struct, [{1, {:i32, 0}}, {2, {:i32, size}}, {3, {:i32, stored}}, {5, page}]})

    n = IO.iodata_length(head)

    meta = [
      {1, {:i32, Column.physical(column)}},
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

  @doc "The footer, and the file's own name."
  @spec finish(t()) :: {:ok, rows :: non_neg_integer()} | {:error, Error.t()}
  def finish(writer) do
    root = {:struct, [{4, {:binary, "situ"}}, {5, {:i32, length(writer.columns)}}]}

    footer =
      Thrift.write(
        {:struct,
         [
           {1, {:i32, 2}},
           {2, {:list, [root | Enum.map(writer.columns, &Column.element/1)]}},
           {3, {:i64, writer.rows}},
           {4, {:list, Enum.reverse(writer.groups)}},
           {6, {:binary, "situ"}}
         ]}
      )

    with :ok <-
           :file.write(writer.file, [footer, <<IO.iodata_length(footer)::little-32>>, "PAR1"]),
         :ok <- :file.close(writer.file),
         :ok <- :file.rename(unfinished(writer.path), writer.path) do
      {:ok, writer.rows}
    else
      {:error, reason} -> {:error, failed(writer.path, reason)}
    end
  end

  @doc "Deletes the unfinished file."
  @spec abandon(t()) :: :ok
  def abandon(writer) do
    :file.close(writer.file)
    :file.delete(unfinished(writer.path))
    :ok
  end

  defp failed(path, :enospc), do: Error.new(:disk_full, "no room left on the disk of #{path}")

  defp failed(path, reason),
    do: Error.new(:io, "cannot write #{path}", why: to_string(:file.format_error(reason)))
end

defmodule Situ.Bridge.Parquet.PackedColumns do
  @moduledoc false
  # Reads and writes tables as columns of packed numbers, without a term for each value.
  alias Situ.Bridge.Columnar.Column
  alias Situ.Bridge.Parquet.{File, Writer}
  alias Situ.Error

  @sizes %{time: 8, integer: 8, float: 8, boolean: 1}

  @doc "Returns the columns of a file, some rows at a time. Raises `Situ.Error`."
  @spec stream_columns(Path.t(), [String.t()] | nil) :: Enumerable.t()
  def stream_columns(path, names) do
    table = path |> File.open() |> Error.unwrap!()
    columns = if names, do: Enum.map(names, &fetch_column(table, &1)), else: table.columns
    names = Enum.map(columns, & &1.name)

    table
    |> File.stream_columns(table.groups, columns)
    |> Stream.map(fn {_rows, values} -> names |> Enum.zip(values) |> Map.new() end)
  end

  defp fetch_column(table, name) do
    Enum.find(table.columns, &(&1.name == name)) ||
      raise Error.new(:no_column, "#{table.path} has no column of #{inspect(name)}",
              why: "its columns are #{Enum.map_join(table.columns, ", ", & &1.name)}"
            )
  end

  @doc "Writes columns into a file and returns the number of rows."
  @spec write_columns([{String.t(), {atom(), binary() | list()}}], Path.t(), keyword()) ::
          {:ok, non_neg_integer()} | {:error, Error.t()}
  def write_columns(columns, path, opts) do
    with {:ok, rows} <- count_rows(columns),
         definitions = Enum.map(columns, &define_column/1),
         {:ok, writer} <- Writer.create(path, definitions, opts) do
      columns
      |> Enum.map(fn {_name, {kind, values}} -> split_values(kind, values, opts[:rows]) end)
      |> Enum.zip()
      |> Enum.reduce_while({:ok, writer, rows}, &write_group(&1, &2, opts[:rows]))
      |> finish_file()
    end
  end

  defp define_column({name, {kind, values}}),
    do: %Column{name: name, kind: kind, optional?: is_list(values)}

  defp count_rows(columns) do
    case columns
         |> Enum.map(fn {_name, {kind, values}} -> value_count(kind, values) end)
         |> Enum.uniq() do
      [rows] ->
        {:ok, rows}

      counts ->
        {:error,
         Error.new(:not_writable, "the columns cannot be written as a table",
           why:
             "a table needs columns of the same length, and they have #{inspect(counts)} values",
           fix: "pass at least one column, and as many values for each"
         )}
    end
  end

  defp value_count(_kind, values) when is_list(values), do: length(values)
  defp value_count(kind, bytes), do: bytes |> byte_size() |> Kernel./(@sizes[kind]) |> ceil()

  defp split_values(_kind, values, max) when is_list(values), do: Enum.chunk_every(values, max)

  defp split_values(kind, bytes, max) do
    size = @sizes[kind] * max

    for at <- 0..(byte_size(bytes) - 1)//size,
        do: {:bytes, binary_part(bytes, at, min(size, byte_size(bytes) - at)), max}
  end

  defp write_group(values, {:ok, writer, remaining}, max) do
    rows = min(max, remaining)

    case Writer.write(writer, Tuple.to_list(values), rows) do
      {:ok, writer} -> {:cont, {:ok, writer, remaining - rows}}
      error -> {:halt, {error, writer}}
    end
  end

  defp finish_file({:ok, writer, _remaining}), do: Writer.finish(writer)

  defp finish_file({error, writer}) do
    Writer.abandon(writer)
    error
  end
end

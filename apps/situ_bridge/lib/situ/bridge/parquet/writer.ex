defmodule Situ.Bridge.Parquet.Writer do
  @moduledoc false
  # Writes a Parquet file under a temporary name until it is complete.
  @behaviour Situ.Bridge.Columnar.Writer
  alias Situ.Bridge.Parquet.Program
  alias Situ.Error

  # Long lists of rows are slow to build, so the program collects them until they fill a row group.
  @slice_rows 8_192
  @group_rows 100_000

  @enforce_keys [:program, :path]
  defstruct @enforce_keys ++ [rows: 0]
  @type t :: %__MODULE__{}

  @impl true
  def create(path, columns, opts) do
    writer = %__MODULE__{program: Program.start_program(), path: path}
    columns = for column <- columns, do: {column.name, column.kind, column.optional?}
    file = Path.expand(unfinished_path(writer))
    request = {:create, file, columns, {opts[:compression] || :none, opts[:rows] || @group_rows}}

    case Program.call(writer.program, path, request) do
      {:ok, :ok} ->
        {:ok, writer}

      error ->
        Program.stop_program(writer.program)
        error
    end
  end

  @impl true
  def max_rows(rows), do: min(rows, @slice_rows)

  defp unfinished_path(writer), do: writer.path <> ".unfinished"

  @impl true
  def write(writer, values, rows) do
    request = {:write, rows, request_values(values)}

    with {:ok, :ok} <- Program.call(writer.program, writer.path, request),
         do: {:ok, %{writer | rows: writer.rows + rows}}
  end

  defp request_values({:rows, rows}), do: {:rows, rows}
  defp request_values(columns), do: Enum.map(columns, &column_values/1)

  defp column_values({:bytes, bytes, _n}), do: bytes
  defp column_values(values), do: values

  @impl true
  def finish(writer) do
    result =
      with {:ok, :ok} <- Program.call(writer.program, writer.path, {:finish}),
           do: Elixir.File.rename(unfinished_path(writer), writer.path)

    Program.stop_program(writer.program)

    case result do
      :ok -> {:ok, writer.rows}
      {:error, %Error{} = error} -> {:error, error}
      {:error, reason} -> {:error, rename_error(writer.path, reason)}
    end
  end

  defp rename_error(path, reason),
    do: Error.new(:io, "cannot write #{path}", why: to_string(:file.format_error(reason)))

  @impl true
  def abandon(writer) do
    Program.stop_program(writer.program)
    Elixir.File.rm(unfinished_path(writer))
    :ok
  end
end

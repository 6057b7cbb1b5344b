defmodule Situ.Store.S3.MirrorFile do
  @moduledoc false
  # A sparse file with the fetched blocks of an extent. From the multiple of 4,096 after the extent's bytes on, it has a
  # mark for each block (1 if it was fetched), and a trailer: magic, size of the extent and size of a block. It is one
  # file, so that a program that empties it replaces blocks and marks together.
  alias Situ.Store.S3.Manifest

  @block Manifest.block_size()
  @magic "SITUMIR1"
  @page 4_096
  @trailer 24

  @doc """
  Returns the number of blocks of an extent.

      iex> Enum.map([0, 1, 65_536, 65_537], &Situ.Store.S3.MirrorFile.count_blocks/1)
      [0, 1, 1, 2]
  """
  @spec count_blocks(non_neg_integer()) :: non_neg_integer()
  def count_blocks(size), do: div(size + @block - 1, @block)

  defp table_offset(size), do: div(size + @page - 1, @page) * @page

  @doc "Creates a file without blocks. Raises if it cannot be written."
  @spec create(Path.t(), non_neg_integer()) :: :ok
  def create(path, size) do
    trailer = [@magic, <<size::little-64, @block::little-64>>]
    {:ok, file} = :file.open(path, [:write, :raw, :binary])
    :ok = :file.pwrite(file, table_offset(size) + count_blocks(size), trailer)
    :ok = :file.close(file)
  end

  @doc "Writes blocks from the number `first` on. Raises if they cannot be written."
  @spec write_blocks(Path.t(), non_neg_integer(), non_neg_integer(), binary()) :: :ok
  def write_blocks(path, size, first, bytes) do
    marks = :binary.copy(<<1>>, count_blocks(byte_size(bytes)))
    {:ok, file} = :file.open(path, [:read, :write, :raw, :binary])
    :ok = :file.pwrite(file, first * @block, bytes)
    :ok = :file.pwrite(file, table_offset(size) + first, marks)
    :ok = :file.close(file)
  end

  @doc "Returns the number of fetched bytes, up to a block."
  @spec fetched_bytes(Path.t()) :: non_neg_integer()
  def fetched_bytes(path) do
    case read_marks(path) do
      {:ok, _size, marks} -> @block * length(:binary.matches(marks, <<1>>))
      :error -> 0
    end
  end

  defp read_marks(path) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]) do
      result = read_table(file)
      _ = :file.close(file)
      result
    else
      {:error, _} -> :error
    end
  end

  defp read_table(file) do
    with {:ok, length} when length > @trailer <- :file.position(file, :eof),
         {:ok, <<@magic, size::little-64, _::little-64>>} <-
           :file.pread(file, length - @trailer, @trailer),
         start = table_offset(size),
         {:ok, marks} <- :file.pread(file, start, max(length - @trailer - start, 0)) do
      {:ok, size, marks}
    else
      _ -> :error
    end
  end

  @doc "Replaces a file by one without blocks. Readers that have it open are not disturbed."
  @spec empty(Path.t()) :: :ok
  def empty(path) do
    with {:ok, size, _marks} <- read_marks(path) do
      temporary = "#{path}.#{System.pid()}-#{System.unique_integer([:positive])}.tmp"
      create(temporary, size)
      File.rename!(temporary, path)
    end

    :ok
  end
end

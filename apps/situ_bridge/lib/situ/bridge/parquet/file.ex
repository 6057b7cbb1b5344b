defmodule Situ.Bridge.Parquet.File do
  @moduledoc false
  # A Parquet file as it is read: its columns and its row groups.
  @behaviour Situ.Bridge.Columnar.Reader
  alias Situ.Bridge.Parquet.{Thrift, Tree, Values}
  alias Situ.Error

  @most_footer 67_108_864
  @most_chunk 2_147_483_648
  @enforce_keys [:path, :rows, :columns, :groups, :times]
  defstruct @enforce_keys

  @type t :: %__MODULE__{
          path: Path.t(),
          rows: non_neg_integer(),
          columns: [Tree.column()],
          groups: [map()],
          times: [String.t()]
        }

  # Looks at the footer. Errors: `:io`, `:not_parquet`.
  @impl true
  def open(path), do: guarded(path, fn file -> {:ok, footer(file, path)} end)

  defp guarded(path, fun) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]) do
      try do
        fun.(file)
      catch
        {:not_parquet, why} ->
          {:error, Error.new(:not_parquet, "#{path} cannot be read as Parquet", why: why)}

        {:io, reason} ->
          {:error, io(path, reason)}
      after
        :file.close(file)
      end
    else
      {:error, reason} -> {:error, io(path, reason)}
    end
  end

  defp io(path, reason),
    do: Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))

  defp footer(file, path) do
    {:ok, size} = :file.position(file, :eof)
    if size < 12, do: fail("it is too short")

    n =
      case read(file, size - 8, 8) do
        <<n::little-32, "PAR1">> when n <= @most_footer and n + 12 <= size -> n
        <<_::32, "PARE">> -> fail("it is encrypted")
        _ -> fail("it does not end in PAR1")
      end

    {meta, _} = file |> read(size - 8 - n, n) |> Thrift.read()

    with %{2 => [_root | elements], 3 => rows, 4 => groups} when is_list(groups) <- meta do
      columns = Tree.columns(elements)

      %__MODULE__{
        path: path,
        rows: rows,
        columns: columns,
        groups: groups,
        times: for(%{time?: true, name: name} <- columns, do: name)
      }
    else
      _ -> fail("its footer is malformed")
    end
  end

  @impl true
  def rows(parquet, group, columns) do
    guarded(parquet.path, fn file ->
      {:ok, columns |> Enum.map(&column(file, group, &1)) |> Enum.zip_with(& &1)}
    end)
  end

  defp column(file, %{1 => chunks, 3 => rows}, column)
       when is_list(chunks) and is_integer(rows) do
    case column do
      %{tree: tree} ->
        held =
          for leaf <- tree.leaves, into: %{} do
            {meta, bytes} = chunk(file, chunks, leaf)
            {leaf.at, Values.entries(leaf, bytes, meta[4], meta[5])}
          end

        Tree.values(tree, held, rows)

      leaf ->
        {meta, bytes} = chunk(file, chunks, leaf)
        Values.read(leaf, bytes, meta[4], rows)
    end
  end

  defp column(_file, _group, _column), do: fail("a row group is malformed")

  defp chunk(file, chunks, leaf) do
    case Enum.at(chunks, leaf.at) do
      %{3 => %{4 => codec, 7 => size, 9 => data} = meta}
      when size in 0..@most_chunk and is_integer(codec) and is_integer(data) ->
        # Some writers give 0 for no dictionary.
        dictionary = if is_integer(meta[11]) and meta[11] > 0, do: meta[11], else: data
        {meta, read(file, min(dictionary, data), size)}

      _ ->
        fail("the chunk of #{inspect(leaf.name)} is not there")
    end
  end

  defp read(_file, _at, 0), do: ""

  defp read(file, at, n) when is_integer(at) and at >= 0 do
    {:ok, size} = :file.position(file, :eof)
    if at + n > size, do: fail("it is cut short")

    case :file.pread(file, at, n) do
      {:ok, bytes} when byte_size(bytes) == n -> bytes
      {:error, reason} -> throw({:io, reason})
      _ -> fail("it is cut short")
    end
  end

  defp read(_file, _at, _n), do: fail("a place before its beginning")
  defp fail(why), do: throw({:not_parquet, why})
end

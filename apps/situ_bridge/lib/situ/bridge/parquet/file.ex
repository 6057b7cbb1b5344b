defmodule Situ.Bridge.Parquet.File do
  @moduledoc false
  # A Parquet file as it is read: its columns, and the rows of its row groups, some at a time.
  @behaviour Situ.Bridge.Columnar.Reader
  alias Situ.Bridge.Parquet.{Chunk, Thrift, Tree}
  alias Situ.Error

  @most_footer 67_108_864
  @most_chunk 2_147_483_648
  @slice 1_024
  @enforce_keys [:path, :rows, :columns, :groups, :times, :left_out, :packed?]
  defstruct @enforce_keys

  @type t :: %__MODULE__{
          path: Path.t(),
          rows: non_neg_integer(),
          columns: [Tree.column()],
          groups: [map()],
          times: [String.t()],
          left_out: [],
          packed?: boolean()
        }

  # Looks at the footer. Errors: `:io`, `:not_parquet`.
  @impl true
  def open(path) do
    catch_errors(path, fn ->
      file = open_file(path)

      try do
        {:ok, footer(file, path)}
      after
        :file.close(file)
      end
    end)
  end

  defp open_file(path) do
    case :file.open(path, [:read, :raw, :binary]) do
      {:ok, file} -> file
      {:error, reason} -> throw({:io, reason})
    end
  end

  defp catch_errors(path, fun) do
    fun.()
  catch
    {:not_parquet, why} ->
      {:error, Error.new(:not_parquet, "#{path} cannot be read as Parquet", why: why)}

    {:io, reason} ->
      {:error, io(path, reason)}
  end

  defp io(path, reason),
    do: Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))

  defp footer(file, path) do
    {:ok, size} = :file.position(file, :eof)
    if size < 12, do: fail("it is too short")

    n =
      case read(file, size, size - 8, 8) do
        <<n::little-32, "PAR1">> when n <= @most_footer and n + 12 <= size -> n
        <<_::32, "PARE">> -> fail("it is encrypted")
        _ -> fail("it does not end in PAR1")
      end

    {meta, _} = file |> read(size, size - 8 - n, n) |> Thrift.read()

    with %{2 => [_root | elements], 3 => rows, 4 => groups} when is_list(groups) <- meta do
      columns = Tree.columns(elements)

      %__MODULE__{
        path: path,
        rows: rows,
        columns: columns,
        groups: groups,
        packed?: is_binary(meta[6]) and meta[6] =~ ~r/\Aparquet-cpp-arrow version [0-2]\./,
        left_out: [],
        times: for(%{time?: true, name: name} <- columns, do: name)
      }
    else
      _ -> fail("its footer is malformed")
    end
  end

  @impl true
  def stream_rows(parquet, group, columns) do
    Stream.resource(
      fn -> raise_errors(parquet.path, fn -> start(parquet, group, columns) end) end,
      fn state -> raise_errors(parquet.path, fn -> next_rows(state) end) end,
      fn %{file: file} -> :file.close(file) end
    )
  end

  defp raise_errors(path, fun) do
    path |> catch_errors(fn -> {:ok, fun.()} end) |> Error.unwrap!()
  end

  defp start(parquet, %{1 => chunks, 3 => rows}, columns) when is_list(chunks) and rows >= 0 do
    places = for column <- columns, do: {column, places(column, chunks, rows, parquet.packed?)}

    file = open_file(parquet.path)
    {:ok, size} = :file.position(file, :eof)
    read = fn at, n -> read(file, size, at, n) end

    columns =
      for {column, leaves} <- places,
          do: {column, for({leaf, place} <- leaves, do: Chunk.start(leaf, place, read))}

    %{file: file, columns: columns, left: rows}
  end

  defp start(_parquet, _group, _columns), do: fail("a row group is malformed")

  defp next_rows(%{left: 0} = state), do: {:halt, state}

  defp next_rows(%{left: left} = state) do
    n = min(@slice, left)
    taken = for {column, chunks} <- state.columns, do: take(column, chunks, n)
    rows = taken |> Enum.map(&elem(&1, 0)) |> Enum.zip_with(& &1)
    columns = for {_values, column, chunks} <- taken, do: {column, chunks}
    {rows, %{state | columns: columns, left: left - n}}
  end

  defp take(column, chunks, n) do
    {rows, chunks} = chunks |> Enum.map(&Chunk.take_rows(&1, n)) |> Enum.unzip()

    if Enum.any?(rows, &(length(&1) != n)),
      do: fail("#{inspect(column.name)} has another number of rows than its group")

    {values(column, rows), column, chunks}
  end

  defp values(%{tree: tree}, rows), do: Enum.zip_with(rows, &Tree.row_value(tree, &1))
  defp values(_leaf, [values]), do: values

  defp places(column, chunks, rows, packed?) do
    nested? = is_map_key(column, :tree)

    for leaf <- if(nested?, do: column.tree.leaves, else: [column]) do
      case Enum.at(chunks, leaf.at) do
        %{3 => %{4 => codec, 5 => count, 7 => size, 9 => data} = meta}
        when size in 0..@most_chunk and is_integer(codec) and is_integer(data) and count >= 0 ->
          # Some writers give 0 for no dictionary.
          dictionary = if is_integer(meta[11]) and meta[11] > 0, do: meta[11], else: data

          {leaf,
           %{
             at: min(dictionary, data),
             size: size,
             packing: %{codec: codec, packed?: packed?},
             count: if(nested?, do: count, else: rows),
             nested?: nested?
           }}

        _ ->
          fail("the chunk of #{inspect(leaf.name)} is not there")
      end
    end
  end

  defp read(_file, _size, _at, 0), do: ""

  defp read(file, size, at, n) when at >= 0 and n > 0 do
    if at + n > size, do: fail("it is cut short")

    case :file.pread(file, at, n) do
      {:ok, bytes} when byte_size(bytes) == n -> bytes
      {:error, reason} -> throw({:io, reason})
      _ -> fail("it is cut short")
    end
  end

  defp read(_file, _size, _at, _n), do: fail("a place before its beginning")
  defp fail(why), do: throw({:not_parquet, why})
end

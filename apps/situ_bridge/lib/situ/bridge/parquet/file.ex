defmodule Situ.Bridge.Parquet.File do
  @moduledoc false
  # Reads a Parquet file: its columns, and the rows of its row groups, a few at a time.
  @behaviour Situ.Bridge.Columnar.Reader
  alias Situ.Bridge.Columnar.Input
  alias Situ.Bridge.Parquet.{Chunk, Thrift, SchemaTree}

  @format {:not_parquet, "Parquet"}
  @max_footer 67_108_864
  @max_chunk 2_147_483_648
  @slice_rows 1_024
  @enforce_keys [:path, :rows, :columns, :groups, :times, :left_out, :packed?]
  defstruct @enforce_keys

  @type t :: %__MODULE__{
          path: Path.t(),
          rows: non_neg_integer(),
          columns: [SchemaTree.column()],
          groups: [map()],
          times: [String.t()],
          left_out: [],
          packed?: boolean()
        }

  # Reads only the footer. Errors: `:io`, `:not_parquet`.
  @impl true
  def open(path), do: Input.with_file(path, @format, &read_footer(&1, path))

  defp read_footer({size, read}, path) do
    if size < 12, do: throw_malformed("it is too short")

    n =
      case read.(size - 8, 8) do
        <<n::little-32, "PAR1">> when n <= @max_footer and n + 12 <= size -> n
        <<_::32, "PARE">> -> throw_malformed("it is encrypted")
        _ -> throw_malformed("it does not end in PAR1")
      end

    {meta, _} = Thrift.decode_struct(read.(size - 8 - n, n))

    with %{2 => [_root | elements], 3 => rows, 4 => groups} when is_list(groups) <- meta do
      columns = SchemaTree.build_columns(elements)

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
      _ -> throw_malformed("its footer is malformed")
    end
  end

  @impl true
  def stream_rows(parquet, group, columns) do
    Input.stream_rows(
      parquet.path,
      @format,
      &start_rows(parquet, group, columns, &1),
      &next_rows/1
    )
  end

  defp start_rows(parquet, %{1 => chunks, 3 => rows}, columns, {_size, read})
       when is_list(chunks) and rows >= 0 do
    locations =
      for column <- columns, do: {column, locate_chunks(column, chunks, rows, parquet.packed?)}

    columns =
      for {column, leaves} <- locations,
          do:
            {column,
             for({leaf, location} <- leaves, do: Chunk.start_reading(leaf, location, read))}

    %{columns: columns, remaining: rows}
  end

  defp start_rows(_parquet, _group, _columns, _input),
    do: throw_malformed("a row group is malformed")

  defp next_rows(%{remaining: 0}), do: :done

  defp next_rows(%{remaining: remaining} = state) do
    n = min(@slice_rows, remaining)
    results = for {column, chunks} <- state.columns, do: take_column(column, chunks, n)
    rows = results |> Enum.map(&elem(&1, 0)) |> Enum.zip_with(& &1)
    columns = for {_values, column, chunks} <- results, do: {column, chunks}
    {rows, %{state | columns: columns, remaining: remaining - n}}
  end

  defp take_column(column, chunks, n) do
    {rows, chunks} = chunks |> Enum.map(&Chunk.take_rows(&1, n)) |> Enum.unzip()

    if Enum.any?(rows, &(length(&1) != n)),
      do: throw_malformed("#{inspect(column.name)} does not have as many rows as its group")

    {column_values(column, rows), column, chunks}
  end

  defp column_values(%{tree: tree}, rows),
    do: Enum.zip_with(rows, &SchemaTree.row_value(tree, &1))

  defp column_values(_leaf, [values]), do: values

  defp locate_chunks(column, chunks, rows, packed?) do
    nested? = is_map_key(column, :tree)

    for leaf <- if(nested?, do: column.tree.leaves, else: [column]) do
      case Enum.at(chunks, leaf.at) do
        %{3 => %{4 => codec, 5 => count, 7 => size, 9 => data} = meta}
        when size in 0..@max_chunk and is_integer(codec) and is_integer(data) and count >= 0 ->
          # Some writers set the offset to 0 for chunks without a dictionary.
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
          throw_malformed("the chunk of #{inspect(leaf.name)} is missing or malformed")
      end
    end
  end

  defp throw_malformed(why), do: throw({:not_parquet, why})
end

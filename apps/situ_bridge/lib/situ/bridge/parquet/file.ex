defmodule Situ.Bridge.Parquet.File do
  @moduledoc false
  # A Parquet file as it is read: its columns (those that are not nested), and its row groups.
  @behaviour Situ.Bridge.Columnar.Reader
  alias Situ.Bridge.Parquet.{Thrift, Values}
  alias Situ.Error

  @most_footer 67_108_864
  @most_chunk 2_147_483_648
  # Factors to nanoseconds: by the old kinds of times and by the units of the new ones.
  @old_kinds %{6 => {:times, 86_400_000_000_000}, 9 => {:times, 1_000_000}, 10 => {:times, 1_000}}
  @units %{1 => {:times, 1_000_000}, 2 => {:times, 1_000}, 3 => nil}
  @unsigned %{11 => 8, 12 => 16, 13 => 32, 14 => 64}

  @enforce_keys [:path, :rows, :columns, :groups, :nested, :times]
  defstruct @enforce_keys

  @type t :: %__MODULE__{
          path: Path.t(),
          rows: non_neg_integer(),
          columns: [Values.leaf()],
          groups: [map()],
          nested: [String.t()],
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
      {columns, nested} = leaves(elements, 0, [], [])

      %__MODULE__{
        path: path,
        rows: rows,
        columns: columns,
        groups: groups,
        nested: nested,
        times: for(%{time?: true, name: name} <- columns, do: name)
      }
    else
      _ -> fail("its footer is malformed")
    end
  end

  # `at` counts the leaves, which row groups have in this order.
  defp leaves([], _at, found, nested), do: {Enum.reverse(found), Enum.reverse(nested)}

  defp leaves([%{4 => name} = element | rest], at, found, nested) do
    cond do
      is_integer(element[5]) ->
        {passed, rest} = below(element[5], rest, 0)
        leaves(rest, at + passed, found, [name | nested])

      element[3] == 2 ->
        leaves(rest, at + 1, found, [name | nested])

      true ->
        leaves(rest, at + 1, [leaf(element, at) | found], nested)
    end
  end

  defp leaves(_other, _at, _found, _nested), do: fail("its schema is malformed")

  # The leaves below a group of columns.
  defp below(0, rest, passed), do: {passed, rest}

  defp below(children, [element | rest], passed) when children > 0 do
    if is_integer(element[5]) do
      {more, rest} = below(element[5], rest, 0)
      below(children - 1, rest, passed + more)
    else
      below(children - 1, rest, passed + 1)
    end
  end

  defp below(_children, _rest, _passed), do: fail("its schema is malformed")

  defp leaf(element, at) do
    as = as(element)
    time? = match?(%{8 => _}, element[10]) or element[6] in [9, 10] or element[1] == 3

    %{
      at: at,
      name: element[4],
      type: element[1],
      length: element[2] || 0,
      optional?: element[3] == 1,
      as: as,
      time?: time?
    }
  end

  defp as(%{10 => %{8 => %{2 => unit}}}) when map_size(unit) == 1,
    do: @units[unit |> Map.keys() |> hd()]

  defp as(%{6 => 5, 7 => scale}) when scale in 0..38, do: {:scale, scale}
  defp as(%{6 => kind}) when is_map_key(@unsigned, kind), do: {:unsigned, @unsigned[kind]}
  defp as(%{6 => kind}), do: @old_kinds[kind]
  defp as(_), do: nil

  @impl true
  def rows(parquet, group, columns) do
    guarded(parquet.path, fn file ->
      {:ok, columns |> Enum.map(&chunk(file, group, &1)) |> Enum.zip_with(& &1)}
    end)
  end

  defp chunk(file, %{1 => chunks, 3 => rows}, leaf) when is_list(chunks) and is_integer(rows) do
    case Enum.at(chunks, leaf.at) do
      %{3 => %{4 => codec, 7 => size, 9 => data} = meta} when size in 0..@most_chunk ->
        # Some writers give 0 for no dictionary.
        at = if (meta[11] || 0) > 0, do: min(meta[11], data), else: data
        Values.read(leaf, read(file, at, size), codec, rows)

      _ ->
        fail("the chunk of #{inspect(leaf.name)} is not there")
    end
  end

  defp chunk(_file, _group, _leaf), do: fail("a row group is malformed")

  defp read(_file, _at, 0), do: ""

  defp read(file, at, n) when at >= 0 do
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

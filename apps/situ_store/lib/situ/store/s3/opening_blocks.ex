defmodule Situ.Store.S3.OpeningBlocks do
  @moduledoc false
  # Chooses the blocks of a store that are read when it is opened, so that its manifest can contain them: the beginnings
  # of all extents, the catalog, the first and last messages of each stream, and coarse summaries.
  alias Situ.Store.S3.Manifest

  @block Manifest.block_size()
  # Summaries are added, the coarsest first, until the blocks have this size.
  @budget 4 * 1024 * 1024
  # At least the beginnings and ends must fit.
  @most 16 * 1024 * 1024
  @lanes %{0 => "data", 1 => "large"}

  @doc "Returns `{file, first_block, bytes}` for each run of blocks of the store in a folder with this index."
  @spec read(Path.t(), binary()) :: [{String.t(), non_neg_integer(), binary()}]
  def read(folder, index) do
    entries = parse_entries(index)

    needed =
      for(entry <- entries, entry.number == 0, do: {entry.lane, entry.extent, 0, 64}) ++
        Enum.flat_map(catalog_entries(entries) ++ end_entries(entries), &[entry_range(&1)])

    blocks = MapSet.new(Enum.flat_map(Enum.uniq(needed), &list_blocks/1))
    blocks = if MapSet.size(blocks) * @block > @most, do: MapSet.new(), else: blocks

    entries
    |> Enum.filter(&(&1.level in 1..126))
    |> Enum.sort_by(&rem(&1.level, 64), :desc)
    |> Enum.reduce_while(blocks, &add_summary/2)
    |> group_runs()
    |> Enum.map(fn {file, first, count} ->
      {file, first, read_blocks(Path.join(folder, file), first, count)}
    end)
    |> Enum.reject(fn {_, _, bytes} -> bytes == "" end)
  end

  # The entries of an index; `number` counts the entries of each extent.
  defp parse_entries(<<_::binary-size(64), committed::little-64, _::binary>> = index) do
    entries = binary_part(index, 4_096, min(committed * 64, byte_size(index) - 4_096))
    collect_entries(entries, %{}, [])
  end

  defp collect_entries(
         <<_crc::32, stream::little-32, level, lane, _::16, extent::little-32, offset::little-64,
           length::little-32, _::binary-size(36), rest::binary>>,
         counts,
         entries
       ) do
    number = Map.get(counts, {lane, extent}, 0)

    entry = %{
      stream: stream,
      level: level,
      lane: lane,
      extent: extent,
      offset: offset,
      length: length,
      number: number
    }

    collect_entries(rest, Map.put(counts, {lane, extent}, number + 1), [entry | entries])
  end

  defp collect_entries(_rest, _counts, entries),
    do:
      entries |> Enum.reverse() |> Enum.filter(&(is_map_key(@lanes, &1.lane) and &1.level < 255))

  defp catalog_entries(entries), do: Enum.filter(entries, &(&1.stream == 0 and &1.level == 0))

  # Of large messages, the header is enough.
  defp end_entries(entries) do
    messages = Enum.filter(entries, &(&1.level == 0))
    last = Map.new(messages, &{&1.stream, &1})
    first = messages |> Enum.reverse() |> Map.new(&{&1.stream, &1})

    for entry <- Map.values(last) ++ Map.values(first),
        do: if(entry.lane == 1, do: %{entry | length: min(entry.length, 256)}, else: entry)
  end

  defp add_summary(entry, blocks) do
    more = entry |> entry_range() |> list_blocks() |> Enum.into(blocks)
    if MapSet.size(more) * @block > @budget, do: {:halt, blocks}, else: {:cont, more}
  end

  defp entry_range(entry), do: {entry.lane, entry.extent, entry.offset, entry.length}

  defp list_blocks({lane, extent, offset, length}) do
    file = "#{@lanes[lane]}-#{String.pad_leading(to_string(extent), 6, "0")}.situ"
    last = div(offset + max(length, 1) - 1, @block)
    for block <- div(offset, @block)..last, do: {file, block}
  end

  defp group_runs(blocks) do
    blocks
    |> Enum.sort()
    |> Enum.chunk_while(
      nil,
      fn
        {file, block}, {file, first, count} when block == first + count ->
          {:cont, {file, first, count + 1}}

        {file, block}, nil ->
          {:cont, {file, block, 1}}

        {file, block}, run ->
          {:cont, run, {file, block, 1}}
      end,
      fn run -> if run, do: {:cont, run, nil}, else: {:cont, nil} end
    )
  end

  defp read_blocks(path, first, count) do
    with {:ok, file} <- :file.open(path, [:read, :raw, :binary]) do
      result = :file.pread(file, first * @block, count * @block)
      _ = :file.close(file)
      if match?({:ok, _}, result), do: elem(result, 1), else: ""
    else
      {:error, _} -> ""
    end
  end
end

defmodule Situ.Store.S3.Mirror do
  @moduledoc false
  # A local folder that represents a remote store: its whole index, and sparse files for its extents, whose blocks are
  # fetched when a reader needs them (`native/situ_store/src/reader/residency.rs`).
  #
  # An extent `data-000000.mirror` has the extent's bytes, and from the next multiple of 4,096 on, a mark for each block
  # and a trailer. `data-000000.sums` has the checksums of the blocks.
  # See docs/adr/0194-recordings-in-object-storage-are-read-through-mirrors.md.
  alias Situ.Error
  alias Situ.Store.S3.{Address, Cache, Client, Eviction, Manifest, MirrorFile}

  @block Manifest.block_size()

  # The smallest fetch, and the limit of reading ahead, in blocks.
  @least_blocks 4
  @most_ahead 64
  # Ranges with gaps up to this are fetched together.
  @gap_blocks 4
  @most_rounds 200

  @lanes %{0 => "data", 1 => "large"}

  @doc "Creates the table that detects sequential reading. The calling process owns it."
  @spec create_table() :: :ets.table()
  def create_table, do: :ets.new(__MODULE__, [:named_table, :public, :set])

  @doc "Creates the mirror of a recording in a folder that does not exist yet."
  @spec create(Path.t(), Manifest.t(), Address.t()) :: :ok | {:error, Error.t()}
  def create(folder, %Manifest{} = manifest, %Address{} = address) do
    temporary = "#{folder}.#{System.pid()}-#{System.unique_integer([:positive])}.tmp"

    try do
      File.mkdir_p!(temporary)

      for file <- manifest.files,
          do: MirrorFile.create(mirror_path(temporary, file.name), file.size)

      Enum.each(manifest.parts, &write_part(temporary, &1, manifest.files))
      File.write!(Path.join(temporary, "mirror.json"), encode_description(manifest, address))
      rename_folder(temporary, folder)
    rescue
      error in [File.Error, MatchError] ->
        _ = File.rm_rf(temporary)
        {:error, write_error(folder, error)}
    end
  end

  # Another process may have created the same mirror.
  defp rename_folder(temporary, folder) do
    with {:error, reason} <- File.rename(temporary, folder) do
      _ = File.rm_rf(temporary)

      if exists?(folder),
        do: :ok,
        else: raise(File.Error, reason: reason, action: "create the folder", path: folder)
    end
  end

  defp write_error(folder, error) do
    Error.new(:io, "cannot write to the cache #{folder}",
      why: Exception.message(error),
      fix: "check the folder and its free space, or set SITU_S3_CACHE to another folder"
    )
  end

  defp encode_description(manifest, address) do
    Situ.JSON.encode(%{
      bucket: address.bucket,
      key: address.key,
      bytes: manifest.bytes,
      files: Enum.map(manifest.files, &Map.take(&1, [:name, :size, :etag]))
    })
  end

  @doc "Returns whether a folder is a complete mirror."
  @spec exists?(Path.t()) :: boolean()
  def exists?(folder), do: File.regular?(Path.join(folder, "mirror.json"))

  defp write_part(folder, {:index, bytes}, _files),
    do: File.write!(Path.join(folder, "index.situ"), bytes)

  defp write_part(folder, {:sums, name, bytes}, _files),
    do: File.write!(Path.join(folder, sums_name(name)), bytes)

  defp write_part(folder, {:blocks, name, first, bytes}, files) do
    %{size: size} = Enum.find(files, &(&1.name == name))
    MirrorFile.write_blocks(mirror_path(folder, name), size, first, bytes)
  end

  defp mirror_path(folder, name),
    do: Path.join(folder, Path.rootname(name, ".situ") <> ".mirror")

  defp sums_name(name), do: Path.rootname(name, ".situ") <> ".sums"
  defp count_blocks(size), do: MirrorFile.count_blocks(size)

  @doc "Returns the size of the remote recording in bytes, or `nil` if the folder is not a mirror."
  @spec remote_bytes(Path.t()) :: non_neg_integer() | nil
  def remote_bytes(folder) do
    case read_description(folder) do
      {:ok, %{bytes: bytes}} -> bytes
      _ -> nil
    end
  end

  defp read_description(folder) do
    with {:ok, text} <- File.read(Path.join(folder, "mirror.json")),
         {:ok, %{"bucket" => bucket, "key" => key, "files" => files} = value} <-
           Situ.JSON.decode(text) do
      files =
        for %{"name" => name, "size" => size} = file <- files,
            do: %{name: name, size: size, etag: file["etag"]}

      {:ok, %{bucket: bucket, key: key, files: files, bytes: value["bytes"]}}
    else
      _ -> {:error, not_mirror_error(folder)}
    end
  end

  defp not_mirror_error(folder) do
    Error.new(:not_a_store, "the cached recording #{folder} is incomplete",
      why: "its description was deleted or is damaged",
      fix: "open the recording again"
    )
  end

  @doc """
  Runs a function of a reader. If its store is a mirror that lacks bytes (`{:absent, ranges}`), fetches them and runs
  the function again. Returns `{:error, error}` if they cannot be fetched.
  """
  @spec with_bytes(Path.t(), (() -> result)) :: result | {:error, Error.t()} when result: term()
  def with_bytes(folder, read), do: read_again(folder, read, @most_rounds)

  defp read_again(folder, read, rounds) do
    case read.() do
      {:absent, _} when rounds == 0 ->
        {:error, thrashing_error(folder)}

      {:absent, ranges} ->
        with :ok <- fetch_ranges(folder, ranges), do: read_again(folder, read, rounds - 1)

      result ->
        result
    end
  end

  # Another process empties the extent again and again.
  defp thrashing_error(folder) do
    Error.new(:cache_too_small, "the cache is too small to read #{Path.basename(folder)}",
      why: "its bytes were removed before they were read",
      fix: "raise SITU_S3_CACHE_BYTES"
    )
  end

  defp fetch_ranges(folder, ranges) do
    # Only the user's own cache may cause requests, not a folder from another author.
    with true <- Cache.contains?(folder) || {:error, not_mirror_error(folder)},
         {:ok, description} <- read_description(folder) do
      _ = File.touch(Path.join(folder, "mirror.json"))

      result =
        ranges
        |> Enum.group_by(fn {lane, extent, _, _} -> file_name(lane, extent) end)
        |> Enum.reduce_while(:ok, fn {name, ranges}, :ok ->
          continue_if_ok(fetch_file(folder, description, name, ranges))
        end)

      note_fetched(folder, ranges)
      result
    end
  end

  defp continue_if_ok(:ok), do: {:cont, :ok}
  defp continue_if_ok(error), do: {:halt, error}

  defp file_name(lane, extent),
    do: "#{@lanes[lane]}-#{String.pad_leading(to_string(extent), 6, "0")}.situ"

  defp fetch_file(folder, description, name, ranges) do
    case Enum.find(description.files, &(&1.name == name)) do
      nil ->
        {:error, not_mirror_error(folder)}

      file ->
        blocks = for {_, _, offset, length} <- ranges, do: block_range(offset, length, file.size)
        merged = blocks |> Enum.sort() |> merge_ranges()

        wanted = read_ahead({folder, name}, merged, count_blocks(file.size))
        fill_ranges(folder, description, file, wanted, fn _ -> :ok end)
    end
  end

  @doc "Fetches all blocks of a file of a mirror."
  @spec fill_file(Path.t(), map(), map(), (non_neg_integer() -> any())) ::
          :ok | {:error, Error.t()}
  def fill_file(folder, remote, file, progress),
    do: fill_ranges(folder, remote, file, [{0, count_blocks(file.size) - 1}], progress)

  defp fill_ranges(_folder, _remote, %{size: 0}, _ranges, _progress), do: :ok

  defp fill_ranges(folder, remote, file, ranges, progress) do
    command = %{
      op: "fill",
      bucket: remote.bucket,
      key: "#{remote.key}/#{file.name}",
      etag: file.etag,
      path: mirror_path(folder, file.name),
      sums: Path.join(folder, sums_name(file.name)),
      size: file.size,
      block: @block,
      ranges: Enum.map(ranges, &Tuple.to_list/1)
    }

    with {:ok, _} <- Client.request(command, "", progress), do: :ok
  end

  defp block_range(offset, length, size) do
    last = min(offset + length, size) - 1
    {div(offset, @block), max(div(last, @block), div(offset, @block))}
  end

  @doc """
  Merges sorted ranges of blocks that overlap or are close.

      iex> Situ.Store.S3.Mirror.merge_ranges([{0, 1}, {1, 3}, {7, 7}, {20, 21}])
      [{0, 7}, {20, 21}]
  """
  @spec merge_ranges([{non_neg_integer(), non_neg_integer()}]) :: [
          {non_neg_integer(), non_neg_integer()}
        ]
  def merge_ranges([{a, b}, {c, d} | rest]) when c <= b + @gap_blocks,
    do: merge_ranges([{a, max(b, d)} | rest])

  def merge_ranges([range | rest]), do: [range | merge_ranges(rest)]
  def merge_ranges([]), do: []

  # Doubles the number of blocks to fetch in advance while a file is read in order.
  defp read_ahead(key, ranges, count) do
    {first, last} = List.last(ranges)
    ahead = next_window(lookup_window(key), {first, last})
    last = min(max(last + ahead, first + @least_blocks - 1), count - 1)
    put_window(key, {last + 1, ahead})
    List.replace_at(ranges, -1, {first, last})
  end

  @doc """
  Returns how many blocks to read ahead, from the end and the size of the last fetch, and the first and last block of
  this one.

      iex> alias Situ.Store.S3.Mirror
      iex> {Mirror.next_window({8, 4}, {7, 9}), Mirror.next_window({8, 4}, {100, 101})}
      {8, 0}
  """
  @spec next_window(
          {integer(), non_neg_integer()},
          {non_neg_integer(), non_neg_integer()}
        ) :: non_neg_integer()
  def next_window({next, ahead}, {first, last})
      when last >= next - 1 and first <= next + @gap_blocks,
      do: ahead |> max(div(@least_blocks, 2)) |> Kernel.*(2) |> min(@most_ahead)

  def next_window(_last_fetch, _range), do: 0

  defp lookup_window(key) do
    case :ets.whereis(__MODULE__) != :undefined && :ets.lookup(__MODULE__, key) do
      [{_, window}] -> window
      _ -> {-100, 0}
    end
  end

  defp put_window(key, window) do
    if :ets.whereis(__MODULE__) != :undefined do
      if :ets.info(__MODULE__, :size) > 10_000, do: :ets.delete_all_objects(__MODULE__)
      :ets.insert(__MODULE__, {key, window})
    end
  end

  # The cache's size is checked after each sixteenth of its limit.
  defp note_fetched(_folder, ranges) do
    bytes = ranges |> Enum.map(&elem(&1, 3)) |> Enum.sum()

    if :ets.whereis(__MODULE__) != :undefined do
      sum = :ets.update_counter(__MODULE__, :fetched, bytes, {:fetched, 0})

      if sum > div(Cache.max_bytes(), 16) do
        :ets.delete(__MODULE__, :fetched)
        Eviction.limit_size()
      end
    end

    :ok
  end
end

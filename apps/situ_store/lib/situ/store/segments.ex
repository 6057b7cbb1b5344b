defmodule Situ.Store.Segments do
  @moduledoc false
  # Finds the segments of a segmented recording: the versions of a name that are marked as segments in their catalogs.
  # Other versions of the name are separate recordings.
  # See docs/adr/0168-segments-of-a-name-are-one-recording.md.
  alias Situ.Store.{Folder, NativeFormat}

  # Marks never change, so they are cached by the identity of the index file.
  @most_cached 50_000

  @doc "Creates the cache. The calling process owns it."
  @spec create_cache() :: :ets.table()
  def create_cache,
    do: :ets.new(__MODULE__, [:named_table, :public, :set, read_concurrency: true])

  @doc """
  Returns whether the store in a folder is a segment. Returns `:unmarked` if the store has no streams, because its
  recorder has just begun or was killed at that moment, and the error if the store cannot be opened.
  """
  @spec check_segment(Path.t()) :: boolean() | :unmarked | {:error, Situ.Error.t()}
  def check_segment(folder) do
    inode = index_inode(folder)

    case inode && cached(folder) do
      {^inode, segment?} -> segment?
      _ -> read_mark(folder, inode)
    end
  end

  defp index_inode(folder) do
    case :file.read_file_info(Path.join(folder, "index.situ"), [:raw]) do
      {:ok, info} -> elem(info, 11)
      {:error, _} -> nil
    end
  end

  defp cached(folder) do
    case :ets.whereis(__MODULE__) != :undefined && :ets.lookup(__MODULE__, folder) do
      [{_, inode, segment?}] -> {inode, segment?}
      _ -> nil
    end
  end

  defp read_mark(folder, inode) do
    with {:ok, state} <- NativeFormat.open(folder, []) do
      segment? = NativeFormat.info(state).piece != nil

      # A segment is marked before its first stream. A repair closes a store without content, but does not mark it.
      if segment? or NativeFormat.streams(state) != [] do
        put_cached(folder, inode, segment?)
        segment?
      else
        :unmarked
      end
    end
  rescue
    error in Situ.Error -> {:error, error}
  end

  defp put_cached(folder, inode, segment?) do
    if :ets.whereis(__MODULE__) != :undefined do
      if :ets.info(__MODULE__, :size) > @most_cached, do: :ets.delete_all_objects(__MODULE__)
      :ets.insert(__MODULE__, {folder, inode, segment?})
    end
  end

  @doc "Returns whether `path` is the name of a segmented recording: whether its newest readable version is a segment."
  @spec segmented?(Path.t()) :: boolean()
  def segmented?(path),
    do: not Folder.store_folder?(path) and newest_segment?(list_versions(path))

  defp list_versions(path), do: Folder.list_versions(Path.basename(path), Path.dirname(path))

  # A version that a crash left without an index or without content says nothing about the others.
  defp newest_segment?(versions) do
    versions
    |> Enum.reverse()
    |> Stream.map(&check_segment/1)
    |> Enum.find(false, &is_boolean/1)
  end

  @doc "Returns the folders of the segments of a recording ROOT/NAME, oldest first."
  @spec list_folders(Path.t()) :: [Path.t()]
  def list_folders(path), do: path |> list_versions() |> Enum.filter(&(check_segment(&1) == true))

  @doc """
  Returns whether a recorder was killed before it wrote the header of the store in a folder. The index then exists at
  most as zeros, and there is no data file, so nothing is lost.
  """
  @spec nothing_written?(Path.t()) :: boolean()
  def nothing_written?(folder) do
    case File.ls(folder) do
      {:ok, files} -> files -- ["lock", "index.situ"] == [] and blank_index?(folder)
      {:error, reason} -> reason == :enoent
    end
  end

  defp blank_index?(folder) do
    case File.open(Path.join(folder, "index.situ"), [:read, :binary], &IO.binread(&1, 4_096)) do
      {:ok, :eof} -> true
      {:ok, bytes} when is_binary(bytes) -> bytes == <<0::size(byte_size(bytes))-unit(8)>>
      {:error, reason} -> reason == :enoent
      _ -> false
    end
  end

  @doc "Returns the folders of a recording ROOT/NAME in which a recorder was killed before it wrote anything."
  @spec list_unmarked(Path.t()) :: [Path.t()]
  def list_unmarked(path),
    do: path |> list_versions() |> Enum.filter(&(check_segment(&1) == :unmarked))

  @doc """
  Returns the folders of a recording ROOT/NAME that belong to it: its segments, and the versions that cannot be read and
  may be segments.
  """
  @spec list_possible_folders(Path.t()) :: [Path.t()]
  def list_possible_folders(path),
    do: path |> list_versions() |> Enum.filter(&(check_segment(&1) != false))

  @doc "Replaces the segments of each recording in a list of stores by the path of the recording, ROOT/NAME."
  @spec combine_segments([Path.t()]) :: [Path.t()]
  def combine_segments(paths) do
    {versions, others} = Enum.split_with(paths, &(Folder.version_number(&1) != nil))

    combined =
      versions
      |> Enum.group_by(&Path.join(Path.dirname(&1), Folder.store_name(&1)))
      |> Enum.flat_map(&combine_versions/1)

    Enum.sort(others ++ combined)
  end

  defp combine_versions({name, versions}) do
    versions = Enum.sort_by(versions, &Folder.version_number/1)

    if newest_segment?(versions) and not Folder.store_folder?(name),
      do: [name | Enum.reject(versions, &(check_segment(&1) in [true, :unmarked]))],
      else: versions
  end
end

defmodule Situ.Store.AtomicFile do
  @moduledoc false
  # Writes and renames files so that a power failure leaves either the old state or the new one.

  @doc """
  Replaces the content of the file `path`. When it returns, the new content is complete and on disk. If it fails, `path`
  is unchanged.

      iex> path = Path.join(System.tmp_dir!(), "situ-doc-atomic-#{System.pid()}")
      iex> Situ.Store.AtomicFile.write(path, ["all", " of it"])
      :ok
      iex> {File.read!(path), File.rm!(path)}
      {"all of it", :ok}
  """
  @spec write(Path.t(), iodata()) :: :ok | {:error, File.posix()}
  def write(path, content) do
    temporary = "#{path}.#{System.pid()}-#{System.unique_integer([:positive])}.tmp"

    with {:ok, device} <- :file.open(temporary, [:write, :raw, :binary, :exclusive]),
         :ok <- write_synced(device, content),
         :ok <- rename_synced(temporary, path) do
      :ok
    else
      {:error, reason} ->
        _ = File.rm(temporary)
        {:error, reason}
    end
  end

  # The functions of :file return errors as values: :file.write/2 to a full disk returns :enospc.
  defp write_synced(device, content) do
    with :ok <- :file.write(device, content), do: :file.sync(device)
  after
    :file.close(device)
  end

  @doc "Renames a file or folder and syncs the new name to disk. The content must already be on disk."
  @spec rename_synced(Path.t(), Path.t()) :: :ok | {:error, File.posix()}
  def rename_synced(from, to) do
    with :ok <- File.rename(from, to) do
      if Path.dirname(from) != Path.dirname(to), do: sync_folder(Path.dirname(from))
      sync_folder(Path.dirname(to))
    end
  end

  @doc """
  Creates a folder and its missing parents, like `File.mkdir_p/1`, and syncs their names to disk.
  """
  @spec make_folder(Path.t()) :: :ok | {:error, File.posix()}
  def make_folder(path) do
    missing = path |> Stream.iterate(&Path.dirname/1) |> Enum.take_while(&(not File.exists?(&1)))

    with :ok <- File.mkdir_p(path) do
      for folder <- Enum.reverse(missing), do: sync_folder(Path.dirname(folder))
      :ok
    end
  end

  @doc "Syncs the files in a folder to disk, then their names. Returns the first error."
  @spec sync_files(Path.t()) :: :ok | {:error, File.posix()}
  def sync_files(folder) do
    with {:ok, names} <- File.ls(folder),
         :ok <- sync_all(Enum.map(names, &Path.join(folder, &1))),
         do: sync_folder(folder)
  end

  defp sync_all([]), do: :ok
  defp sync_all([path | paths]), do: with(:ok <- sync_file(path), do: sync_all(paths))

  @doc "Syncs a file to disk."
  @spec sync_file(Path.t()) :: :ok | {:error, File.posix()}
  def sync_file(path) do
    with {:ok, device} <- :file.open(path, [:read, :raw, :binary]) do
      result = :file.sync(device)
      _ = :file.close(device)
      result
    end
  end

  @doc """
  Syncs the names in a folder to disk. Errors are ignored because some network file systems do not support it.
  """
  @spec sync_folder(Path.t()) :: :ok
  def sync_folder(path) do
    with {:ok, device} <- :file.open(path, [:read, :raw, :directory]) do
      _ = :file.sync(device)
      _ = :file.close(device)
    end

    :ok
  end
end

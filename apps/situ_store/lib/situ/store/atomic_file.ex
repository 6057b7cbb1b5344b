defmodule Situ.Store.AtomicFile do
  @moduledoc """
  Writes files and changes names so that a power cut leaves either the old state or the new one.

      iex> path = Path.join(System.tmp_dir!(), "situ-doc-atomic-#{System.pid()}")
      iex> Situ.Store.AtomicFile.write(path, ["all", " of it"])
      :ok
      iex> {File.read!(path), File.rm!(path)}
      {"all of it", :ok}
  """

  @doc """
  Replaces the file `path` by one with this content, which is then complete and on the disk. On an error `path` is
  unchanged.
  """
  @spec write(Path.t(), iodata()) :: :ok | {:error, File.posix()}
  def write(path, content) do
    temporary = "#{path}.#{System.pid()}-#{System.unique_integer([:positive])}.tmp"

    with {:ok, device} <- :file.open(temporary, [:write, :raw, :binary, :exclusive]),
         :ok <- write_synced(device, content),
         :ok <- rename(temporary, path) do
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

  @doc "Renames a file or folder and brings the new name to the disk. The content must be on the disk already."
  @spec rename(Path.t(), Path.t()) :: :ok | {:error, File.posix()}
  def rename(from, to) do
    with :ok <- File.rename(from, to) do
      if Path.dirname(from) != Path.dirname(to), do: sync_folder(Path.dirname(from))
      sync_folder(Path.dirname(to))
    end
  end

  @doc """
  Makes a folder and its missing parents, like `File.mkdir_p/1`, and brings their names to the disk.
  """
  @spec make_folder(Path.t()) :: :ok | {:error, File.posix()}
  def make_folder(path) do
    missing = path |> Stream.iterate(&Path.dirname/1) |> Enum.take_while(&(not File.exists?(&1)))

    with :ok <- File.mkdir_p(path) do
      for folder <- Enum.reverse(missing), do: sync_folder(Path.dirname(folder))
      :ok
    end
  end

  @doc "Brings the files in a folder to the disk, then their names. Returns the first error."
  @spec sync_files(Path.t()) :: :ok | {:error, File.posix()}
  def sync_files(folder) do
    with {:ok, names} <- File.ls(folder),
         :ok <- sync_all(Enum.map(names, &Path.join(folder, &1))),
         do: sync_folder(folder)
  end

  defp sync_all([]), do: :ok
  defp sync_all([path | paths]), do: with(:ok <- sync(path), do: sync_all(paths))

  @doc "Brings a file to the disk."
  @spec sync(Path.t()) :: :ok | {:error, File.posix()}
  def sync(path) do
    with {:ok, device} <- :file.open(path, [:read, :raw, :binary]) do
      result = :file.sync(device)
      _ = :file.close(device)
      result
    end
  end

  @doc """
  Brings the names in a folder to the disk. Some network file systems cannot do that, so errors are ignored.
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

defmodule Situ.Store.AtomicFile do
  @moduledoc """
  Files and names that a power cut leaves either as they were or as they are to be.

      iex> path = Path.join(System.tmp_dir!(), "situ-doc-atomic-#{System.pid()}")
      iex> Situ.Store.AtomicFile.write(path, ["all", " of it"])
      :ok
      iex> {File.read!(path), File.rm!(path)}
      {"all of it", :ok}
  """

  @doc "Puts a file with this content in the place of `path`: whole and on the disk, or not at all."
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

  # Through :file, whose errors are values: :file.write/2 to a full disk answers :enospc.
  defp write_synced(device, content) do
    with :ok <- :file.write(device, content), do: :file.sync(device)
  after
    :file.close(device)
  end

  @doc "Renames a file or folder and brings the new name to the disk. The file itself has to be there before."
  @spec rename(Path.t(), Path.t()) :: :ok | {:error, File.posix()}
  def rename(from, to) do
    with :ok <- File.rename(from, to) do
      if Path.dirname(from) != Path.dirname(to), do: sync_folder(Path.dirname(from))
      sync_folder(Path.dirname(to))
    end
  end

  @doc """
  Makes a folder with those above it that are missing, as `File.mkdir_p/1`, and brings the names of those it made to
  the disk.
  """
  @spec make_folder(Path.t()) :: :ok | {:error, File.posix()}
  def make_folder(path) do
    missing = path |> Stream.iterate(&Path.dirname/1) |> Enum.take_while(&(not File.exists?(&1)))

    with :ok <- File.mkdir_p(path) do
      for folder <- Enum.reverse(missing), do: sync_folder(Path.dirname(folder))
      :ok
    end
  end

  @doc "Brings the files in a folder to the disk, then their names. The first error is the answer."
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
  Brings the names in a folder to the disk. File systems that cannot do that (some of networks) are not asked for more
  than they give.
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

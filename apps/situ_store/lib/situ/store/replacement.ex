defmodule Situ.Store.Replacement do
  @moduledoc false
  # A store in the place of another. The two folders exchange their names in one step, where the file system can do
  # that. Where it cannot (some of networks), there is a moment in which the old one is called NAME.before-compaction
  # and nothing has its name: `interrupted/1` finds what a program that was killed then has left, `restore/1` mends it.
  alias Situ.Error
  alias Situ.Store.{AtomicFile, Failure, Folder, Native}

  @before ".before-compaction"
  # Earlier releases kept the new store under this name.
  @compacted ".compacted"

  @doc "Gives `fresh`, whole and on the disk, the name and mode of the store `folder`, which is deleted then."
  @spec put(Path.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def put(fresh, folder) do
    with :ok <- Folder.keep_mode(fresh, folder),
         {:ok, old} <- exchange(fresh, folder),
         :ok <- Folder.remove(old) do
      keep_others(old, folder)
      {:ok, folder}
    end
  end

  # Someone's notes beside the recording.
  defp keep_others(old, folder) do
    with {:ok, names} <- File.ls(old) do
      for name <- names, not File.exists?(Path.join(folder, name)) do
        File.rename(Path.join(old, name), Path.join(folder, name))
      end

      File.rmdir(old)
    end
  end

  defp exchange(fresh, folder) do
    case Native.rename_exchange(fresh, folder) do
      :ok ->
        AtomicFile.sync_folder(Path.dirname(folder))
        {:ok, fresh}

      :unsupported ->
        rename_both(fresh, folder)

      {:error, reason} ->
        {:error, Failure.error(reason, folder)}
    end
  end

  @doc false
  # Where names cannot be exchanged.
  @spec rename_both(Path.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def rename_both(fresh, folder) do
    with :ok <- AtomicFile.rename(folder, folder <> @before),
         :ok <- AtomicFile.rename(fresh, folder) do
      {:ok, folder <> @before}
    else
      {:error, reason} ->
        _ = if not File.exists?(folder), do: File.rename(folder <> @before, folder)
        {:error, Folder.io_error("put #{fresh} in the place of #{folder}", reason)}
    end
  end

  @doc "The store (by the name it is to have) whose replacement was interrupted: `path`, or the newest version of it."
  @spec interrupted(Path.t()) :: Path.t() | nil
  def interrupted(path) do
    [path | versions(Path.dirname(path), Path.basename(path))]
    |> Enum.find(&(File.dir?(&1 <> @before) and not File.exists?(&1)))
  end

  defp versions(root, name) do
    with {:ok, entries} <- File.ls(root) do
      for entry <- Enum.sort(entries, :desc),
          String.starts_with?(entry, name <> ".") and String.ends_with?(entry, @before),
          version = binary_part(entry, 0, byte_size(entry) - byte_size(@before)),
          Regex.match?(~r/\.\d{4,}\z/, version),
          do: Path.join(root, version)
    else
      {:error, _} -> []
    end
  end

  @doc "Gives the store its name back."
  @spec restore(Path.t()) :: :ok | {:error, Error.t()}
  def restore(folder) do
    case AtomicFile.rename(folder <> @before, folder) do
      :ok ->
        # A copy, whole or not, of what has its name again.
        _ = if File.dir?(folder <> @compacted), do: Folder.remove(folder <> @compacted)
        :ok

      {:error, reason} ->
        {:error, Folder.io_error("give #{folder} its name back", reason)}
    end
  end
end

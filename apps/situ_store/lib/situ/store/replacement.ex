defmodule Situ.Store.Replacement do
  @moduledoc false
  # Replaces a store with another. The two folders exchange their names in one step if the file system supports it. On
  # other file systems, such as some network file systems, the old store is briefly named NAME.before-compaction and no
  # store has its name. If a program was killed at that point, `find_interrupted/1` finds the store and `restore_name/1`
  # repairs it.
  alias Situ.Error
  alias Situ.Store.{AtomicFile, NativeErrors, Folder, Native}

  @before ".before-compaction"
  # Earlier releases kept the new store under this name.
  @compacted ".compacted"

  @doc "Replaces the store `folder` with `fresh`, which must be complete and on disk. Keeps its name and mode."
  @spec replace_store(Path.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def replace_store(fresh, folder) do
    with :ok <- Folder.keep_mode(fresh, folder),
         {:ok, old} <- exchange_folders(fresh, folder),
         :ok <- Folder.remove_store(old) do
      keep_others(old, folder)
      {:ok, folder}
    end
  end

  # The old folder may also contain a user's own files.
  defp keep_others(old, folder) do
    with {:ok, names} <- File.ls(old) do
      for name <- names, not File.exists?(Path.join(folder, name)) do
        File.rename(Path.join(old, name), Path.join(folder, name))
      end

      File.rmdir(old)
    end
  end

  defp exchange_folders(fresh, folder) do
    case Native.rename_exchange(fresh, folder) do
      :ok ->
        AtomicFile.sync_folder(Path.dirname(folder))
        {:ok, fresh}

      :unsupported ->
        rename_both(fresh, folder)

      {:error, reason} ->
        {:error, NativeErrors.to_error(reason, folder)}
    end
  end

  @doc "Replaces `folder` with two renames, for file systems without an exchange. Returns the old store's new path."
  @spec rename_both(Path.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def rename_both(fresh, folder) do
    with :ok <- AtomicFile.rename_synced(folder, folder <> @before),
         :ok <- AtomicFile.rename_synced(fresh, folder) do
      {:ok, folder <> @before}
    else
      {:error, reason} ->
        _ = if not File.exists?(folder), do: File.rename(folder <> @before, folder)
        {:error, Folder.io_error("replace #{folder} with #{fresh}", reason)}
    end
  end

  @doc "Returns the store whose replacement was interrupted, by its original name: `path` or its newest version."
  @spec find_interrupted(Path.t()) :: Path.t() | nil
  def find_interrupted(path), do: path |> list_interrupted() |> List.first()

  @doc "Returns all versions of `path` whose replacement was interrupted, the newest first."
  @spec list_interrupted(Path.t()) :: [Path.t()]
  def list_interrupted(path) do
    [path | interrupted_versions(Path.dirname(path), Path.basename(path))]
    |> Enum.filter(&(File.dir?(&1 <> @before) and not File.exists?(&1)))
  end

  defp interrupted_versions(root, name) do
    case File.ls(root) do
      {:ok, entries} ->
        for entry <- Enum.sort(entries, :desc),
            String.ends_with?(entry, @before),
            version = String.replace_suffix(entry, @before, ""),
            Folder.version_number(version) != nil and Folder.store_name(version) == name,
            do: Path.join(root, version)

      {:error, _} ->
        []
    end
  end

  @doc "Restores the store's original name."
  @spec restore_name(Path.t()) :: :ok | {:error, Error.t()}
  def restore_name(folder) do
    case AtomicFile.rename_synced(folder <> @before, folder) do
      :ok ->
        # An earlier release left this copy of the store, which may be incomplete.
        _ = if File.dir?(folder <> @compacted), do: Folder.remove_store(folder <> @compacted)
        :ok

      {:error, reason} ->
        {:error, Folder.io_error("rename #{folder}#{@before} back", reason)}
    end
  end
end

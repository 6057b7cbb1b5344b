defmodule Situ.Store.Deletion do
  @moduledoc false
  # Deletes the folder of a store. The store disappears in one step: its folder is renamed to NAME.NNNN.*.unfinished
  # first. If the program is killed after that, the next program that deletes or creates a store of this name deletes
  # the files (`Situ.Store.Draft.delete_abandoned/1`).
  alias Situ.Error
  alias Situ.Store.{AtomicFile, Draft, FileLock, Folder}

  @doc "Deletes a store's files, and its folder if it contains nothing else."
  @spec delete_folder(Path.t()) :: :ok | {:error, Error.t()}
  def delete_folder(folder) do
    hidden = Draft.unfinished_path(folder)

    case Folder.version_number(folder) && FileLock.acquire(Draft.lock_path(hidden)) do
      {:ok, lock} ->
        result = delete_hidden(folder, hidden)
        FileLock.release(lock)
        result

      # Folders without a version number have a user's own name.
      _ ->
        Folder.remove_store(folder)
    end
  end

  defp delete_hidden(folder, hidden) do
    case AtomicFile.rename_synced(folder, hidden) do
      :ok -> with :ok <- Folder.remove_store(hidden), do: keep_other_files(hidden, folder)
      {:error, _} -> Folder.remove_store(folder)
    end
  end

  # The folder may contain a user's own files.
  defp keep_other_files(hidden, folder) do
    _ = if File.dir?(hidden), do: File.rename(hidden, folder)
    :ok
  end
end

defmodule Situ.Store.Draft do
  @moduledoc false
  # Builds a store from other stores. During writing, its folder is NAME.PID-N.unfinished, which is never treated as a
  # store. The store gets its name in one step when it is complete and on disk. The next program that creates a store
  # of this name deletes the drafts of programs that were killed.
  alias Situ.Error
  alias Situ.Store.{AtomicFile, FileLock, Folder, Query, Replacement, Writer}

  @doc """
  Builds a store that `work.(writer)` fills. If an error occurs, the draft is deleted. With `replace: folder`, the new
  store replaces that one.
  """
  @spec build_store({String.t(), Path.t()}, keyword(), (Writer.t() -> :ok | {:error, Error.t()})) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def build_store({name, root}, opts, work) do
    root = Path.expand(root)
    target = resolve_target(name, root, opts)
    base = if elem(target, 0) == :plain, do: root, else: Path.join(root, name)

    with :ok <- check_available(target),
         {:ok, draft, lock} <- claim_draft(base) do
      try do
        delete_abandoned(base)
        draft |> write_draft(name, opts, work) |> finish_draft(draft, target) |> explain_error()
      after
        FileLock.release(lock)
      end
    end
  end

  defp resolve_target(name, root, opts) do
    cond do
      opts[:replace] -> {:replace, opts[:replace]}
      Keyword.get(opts, :versioned, true) -> {:version, name, root}
      true -> {:plain, name, root}
    end
  end

  # Rejects a name that is taken before the work starts.
  defp check_available({:plain, name, root}) do
    with {:ok, _} <- Folder.create_store_folder(name, root, false), do: :ok
  end

  defp check_available({:version, name, _root}), do: Folder.check_name(name)
  defp check_available({:replace, _folder}), do: :ok

  # The creator of a draft holds its lock until the store has its name, so that no other program deletes the draft.
  defp claim_draft(base) do
    draft = unfinished_path(base)

    with :ok <- Folder.make_parents(base),
         {:ok, lock} <- FileLock.acquire(lock_path(draft)),
         do: {:ok, draft, lock}
  end

  @doc "Returns a new name for an unfinished folder."
  @spec unfinished_path(Path.t()) :: Path.t()
  def unfinished_path(base),
    do:
      "#{base}.#{System.pid()}-#{System.unique_integer([:positive])}#{Folder.unfinished_suffix()}"

  @doc "Returns the path of the lock of an unfinished folder. Only the holder of the lock may change the folder."
  @spec lock_path(Path.t()) :: Path.t()
  def lock_path(draft), do: draft <> ".lock"

  defp write_draft(draft, name, opts, work) do
    options = [versioned: false] ++ Keyword.take(opts, [:durability, :first_extent, :mode])

    with {:ok, writer} <- Writer.create(name, draft, options) do
      result = with :ok <- work.(writer), do: Writer.close(writer)
      _ = if result != :ok, do: Writer.close(writer)
      result
    end
  end

  defp finish_draft(:ok, draft, target) do
    with :ok <- sync_draft(draft), {:ok, path} <- publish_draft(draft, target) do
      {:ok, path}
    else
      {:error, error} -> discard_draft(draft, error)
    end
  end

  defp finish_draft({:error, error}, draft, _target), do: discard_draft(draft, error)

  defp discard_draft(draft, error) do
    _ = if File.dir?(draft), do: Folder.remove_store(draft)
    {:error, error}
  end

  # The copy must survive a power failure even if the user deletes the original immediately after this.
  defp sync_draft(draft) do
    with {:error, reason} <- AtomicFile.sync_files(draft),
         do: {:error, Folder.io_error("sync #{draft} to disk", reason)}
  end

  defp publish_draft(draft, {:version, name, root}), do: Folder.place_version(draft, name, root)
  defp publish_draft(draft, {:plain, _name, root}), do: move_draft(draft, root)
  defp publish_draft(draft, {:replace, folder}), do: Replacement.replace_store(draft, folder)

  # If the folder already contains other files, the store's files are moved into it. The index is moved last because it
  # makes the folder a store.
  defp move_draft(draft, path) do
    with {:error, reason} when reason in [:eexist, :enotempty] <-
           AtomicFile.rename_synced(draft, path) do
      names = draft |> File.ls!() |> Enum.sort() |> Enum.sort_by(&(&1 == "index.situ"))
      for name <- names, do: :ok = File.rename(Path.join(draft, name), Path.join(path, name))
      AtomicFile.sync_folder(path)
      File.rmdir(draft)
    end
    |> case do
      :ok -> {:ok, path}
      {:error, reason} -> {:error, Folder.io_error("rename #{draft}", reason)}
    end
  end

  defp explain_error({:error, %{code: :disk_full} = error}) do
    why = "the incomplete copy was deleted; the original is unchanged"
    {:error, %{error | why: why}}
  end

  defp explain_error(result), do: result

  @doc "Deletes the unfinished folders of a name whose programs were killed."
  @spec delete_abandoned(Path.t()) :: :ok
  def delete_abandoned(base) do
    prefix = Path.basename(base) <> "."

    drafts =
      for entry <- list_entries(Path.dirname(base)),
          String.starts_with?(entry, prefix),
          entry = String.replace_suffix(entry, ".lock", ""),
          Folder.unfinished?(entry),
          uniq: true,
          do: Path.join(Path.dirname(base), entry)

    for path <- drafts,
        not being_written?(path),
        {:ok, lock} <- [FileLock.acquire(lock_path(path))] do
      _ = if File.dir?(path), do: Folder.remove_store(path)
      FileLock.release(lock)
    end

    :ok
  end

  # Drafts of older releases have only the writer's lock.
  defp being_written?(path) do
    case Query.open(path) do
      {:ok, store} -> Query.live?(store)
      {:error, _} -> false
    end
  end

  defp list_entries(folder) do
    case File.ls(folder) do
      {:ok, entries} -> entries
      {:error, _} -> []
    end
  end
end

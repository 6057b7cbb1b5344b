defmodule Situ.Store.S3.Pull do
  @moduledoc false
  # Downloads stores. The files are fetched as a mirror in a folder `.unfinished`, which is renamed when it is complete.
  # An interrupted download continues with the blocks that are missing.
  alias Situ.Error
  alias Situ.Store.{AtomicFile, Folder, Native, NativeErrors, NativeFormat}
  alias Situ.Store.S3.{Listing, Manifest, Mirror, Opening, Push}

  @doc "Downloads a store to a folder, which must not exist. Returns `:present` if it is the same store."
  @spec pull_store(Listing.item(), Path.t(), Push.progress()) ::
          {:ok, :copied | :present} | {:error, Error.t()}
  def pull_store(item, folder, progress) do
    if File.exists?(folder) do
      with {:ok, %{id: id}} <- Opening.fetch_facts(item),
           do:
             if(local_id(folder) == id, do: {:ok, :present}, else: {:error, exists_error(folder)})
    else
      with {:ok, manifest} <- Opening.fetch_manifest(item),
           do: download(item.address, manifest, folder, progress)
    end
  end

  @doc "Returns the id of a local store, or `nil`."
  @spec local_id(Path.t()) :: String.t() | nil
  def local_id(folder) do
    with {:ok, state} <- NativeFormat.open(folder, []), do: NativeFormat.info(state).id
  rescue
    Error -> nil
  end

  defp exists_error(folder) do
    Error.new(:store_exists, "#{folder} is another recording",
      fix: "pull to another name, or delete it with `situ store delete #{folder}`"
    )
  end

  # The store's id is in the name, so that another recording does not continue this one.
  defp download(address, %Manifest{} = manifest, folder, progress) do
    unfinished = "#{folder}.#{String.slice(manifest.id, 0, 8)}#{Folder.unfinished_suffix()}"
    total = manifest.bytes
    done = :counters.new(1, [])

    report = fn bytes ->
      :counters.add(done, 1, bytes)
      progress.(:counters.get(done, 1), total)
    end

    with :ok <- make_parents(folder),
         :ok <- ensure_mirror(unfinished, manifest, address),
         :ok <- fill_files(unfinished, address, manifest, report),
         :ok <- finish_files(unfinished, manifest),
         :ok <- AtomicFile.sync_files(unfinished) |> wrap_io("write", unfinished) do
      rename_finished(unfinished, folder)
    end
  end

  defp make_parents(folder) do
    Folder.make_parents(folder)
  end

  defp ensure_mirror(unfinished, manifest, address) do
    if Mirror.exists?(unfinished) do
      :ok
    else
      _ = File.rm_rf(unfinished)
      Mirror.create(unfinished, manifest, address)
    end
  end

  defp fill_files(unfinished, address, manifest, report) do
    Enum.reduce_while(manifest.files, :ok, fn file, :ok ->
      # A download that was interrupted at its end has renamed some files.
      finished? =
        match?(
          {:ok, %{size: size}} when size == file.size,
          File.stat(Path.join(unfinished, file.name))
        )

      case if(finished?, do: :ok, else: Mirror.fill_file(unfinished, address, file, report)) do
        :ok -> {:cont, :ok}
        error -> {:halt, error}
      end
    end)
  end

  defp finish_files(unfinished, manifest) do
    for file <- manifest.files do
      base = Path.join(unfinished, Path.rootname(file.name, ".situ"))

      with {:ok, device} <- :file.open(base <> ".mirror", [:read, :write, :raw]) do
        {:ok, _} = :file.position(device, file.size)
        :ok = :file.truncate(device)
        :ok = :file.close(device)
        File.rename!(base <> ".mirror", base <> ".situ")
      end

      _ = File.rm(base <> ".sums")
    end

    _ = File.rm(Path.join(unfinished, "mirror.json"))
    :ok
  rescue
    error in [File.Error, File.RenameError, MatchError] ->
      {:error, Error.new(:io, "cannot finish #{unfinished}", why: Exception.message(error))}
  end

  defp wrap_io(:ok, _what, _path), do: :ok

  defp wrap_io({:error, reason}, what, path),
    do: {:error, Folder.io_error("#{what} #{path}", reason)}

  defp rename_finished(unfinished, folder) do
    case Native.rename_new(unfinished, folder) do
      :ok ->
        _ = AtomicFile.sync_folder(Path.dirname(folder))
        {:ok, :copied}

      :unsupported ->
        with :ok <- unfinished |> File.rename(folder) |> wrap_io("rename", unfinished),
             do: {:ok, :copied}

      :exists ->
        {:error, exists_error(folder)}

      {:error, reason} ->
        {:error, NativeErrors.to_error(reason, folder)}
    end
  end
end

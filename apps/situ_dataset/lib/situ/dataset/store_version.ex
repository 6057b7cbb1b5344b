defmodule Situ.Dataset.StoreVersion do
  @moduledoc false
  # An unfinished store is in a folder that no program recognizes as a store; when complete, it becomes the next
  # version ROOT/NAME.NNNN.
  alias Situ.{Error, Store}
  alias Situ.Store.AtomicFile

  @suffix ".unfinished"

  @doc "Returns the folder for a store that will become a version of `ROOT/NAME`."
  @spec draft_path(Path.t()) :: Path.t()
  def draft_path(path),
    do: "#{path}.#{System.pid()}-#{System.unique_integer([:positive])}#{@suffix}"

  @doc "Renames a complete store to the next version; tries the next number if another process has taken it."
  @spec publish_draft(Path.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def publish_draft(draft, path) do
    with {:error, %Error{code: :newer_version}} <-
           publish_after(draft, path, newest_folder(path)),
         do: publish_draft(draft, path)
  end

  @doc """
  Renames a complete store to the version after `base` (a folder; `nil` for the first version). Returns the error
  `:newer_version` if that version exists; the draft is then unchanged.
  """
  @spec publish_after(Path.t(), Path.t(), Path.t() | nil) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def publish_after(draft, path, base) do
    number = base |> version_number() |> Kernel.+(1) |> Integer.to_string()
    folder = "#{path}.#{String.pad_leading(number, 4, "0")}"

    # Renaming would replace an empty folder, which is not a version.
    with :ok <- AtomicFile.sync_files(draft), :ok <- AtomicFile.rename_synced(draft, folder) do
      {:ok, folder}
    else
      {:error, reason} when reason in [:eexist, :enotempty] ->
        {:error,
         Error.new(:newer_version, "#{folder} already exists",
           why: "another process has saved a newer version",
           fix: "read that version and save again"
         )}

      {:error, reason} ->
        {:error,
         Error.new(:not_saved, "cannot rename #{draft} to its final name",
           why: to_string(:file.format_error(reason)),
           fix: "rename the folder to #{folder}; the store in it is complete"
         )}
    end
  end

  @doc "Returns the folder of the newest version of `ROOT/NAME`, or `nil` before the first version."
  @spec newest_folder(Path.t()) :: Path.t() | nil
  def newest_folder(path), do: Store.newest(Path.basename(path), Path.dirname(path))

  @doc "Deletes a draft that was not published; other folders are never deleted."
  @spec discard_draft(Path.t()) :: :ok
  def discard_draft(path) do
    if String.ends_with?(path, @suffix), do: File.rm_rf(path)
    :ok
  end

  defp version_number(nil), do: -1

  defp version_number(folder),
    do: folder |> String.split(".") |> List.last() |> String.to_integer()
end

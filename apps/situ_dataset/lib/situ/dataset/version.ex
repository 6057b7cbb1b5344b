defmodule Situ.Dataset.Version do
  @moduledoc false
  # An unfinished store lies in a folder that no program takes for a store; complete, it becomes the next version
  # ROOT/NAME.NNNN.
  alias Situ.{Error, Store}
  alias Situ.Store.AtomicFile

  @suffix ".unfinished"

  @doc "A folder for a store that is to become a version of `ROOT/NAME`."
  @spec draft(Path.t()) :: Path.t()
  def draft(path), do: "#{path}.#{System.pid()}-#{System.unique_integer([:positive])}#{@suffix}"

  @doc "Gives a whole store its name; a number that another process took meanwhile is followed by the next."
  @spec publish(Path.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def publish(draft, path) do
    with {:error, %Error{code: :newer_version}} <- publish_after(draft, path, newest(path)),
         do: publish(draft, path)
  end

  @doc """
  Makes it the version that follows `base` (a folder, `nil` for the first). Error: `:newer_version` when there is one
  already; then the draft is still a draft.
  """
  @spec publish_after(Path.t(), Path.t(), Path.t() | nil) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def publish_after(draft, path, base) do
    number = base |> number() |> Kernel.+(1) |> Integer.to_string()
    folder = "#{path}.#{String.pad_leading(number, 4, "0")}"

    # An empty folder would be replaced, and is not a version.
    with :ok <- AtomicFile.sync_files(draft), :ok <- AtomicFile.rename(draft, folder) do
      {:ok, folder}
    else
      {:error, reason} when reason in [:eexist, :enotempty] ->
        {:error,
         Error.new(:newer_version, "#{folder} is there already",
           why: "another process saved meanwhile",
           fix: "read it and save again"
         )}

      {:error, reason} ->
        {:error,
         Error.new(:not_saved, "cannot give #{draft} its name",
           why: to_string(:file.format_error(reason)),
           fix: "rename the folder to #{folder}; the store in it is whole"
         )}
    end
  end

  @doc "The folder of the newest version of `ROOT/NAME`; `nil` before the first."
  @spec newest(Path.t()) :: Path.t() | nil
  def newest(path), do: Store.newest(Path.basename(path), Path.dirname(path))

  @doc "Deletes a draft that became nothing; anything else is left alone."
  @spec discard(Path.t()) :: :ok
  def discard(path) do
    if String.ends_with?(path, @suffix), do: File.rm_rf(path)
    :ok
  end

  defp number(nil), do: -1
  defp number(folder), do: folder |> String.split(".") |> List.last() |> String.to_integer()
end

defmodule Situ.Dataset.DatasetFile do
  @moduledoc false
  # Reads and locks a dataset file that several programs may edit. Only one program edits it at a time, and no
  # program overwrites edits that it has not read.
  alias Situ.Error
  alias Situ.Store.{AtomicFile, FileLock}

  # Edits take milliseconds. After this time the error names the program that holds the lock.
  @wait_ms 30_000

  @doc "Runs `fun` with a lock that keeps other programs from editing the file. Error: `:dataset_in_use`."
  @spec with_lock(Path.t(), (() -> result)) :: result | {:error, Error.t()} when result: term()
  def with_lock(path, fun) do
    with :ok <- make_folder(path),
         {:ok, lock} <- FileLock.acquire(path <> ".lock", @wait_ms) do
      try do
        fun.()
      after
        FileLock.release(lock)
      end
    else
      {:held, holder} -> {:error, in_use_error(path, holder)}
      error -> error
    end
  end

  defp make_folder(path) do
    with {:error, reason} <- AtomicFile.make_folder(Path.dirname(path)),
         do: {:error, not_saved_error(path, reason)}
  end

  defp in_use_error(path, holder) do
    Error.new(:dataset_in_use, "the dataset #{path} is being edited",
      why: FileLock.describe_holder(holder),
      fix: "wait for that program or quit it, and edit again",
      meta: %{holder: holder}
    )
  end

  @doc "Returns the digest of the text of a dataset file, which detects changes."
  @spec text_digest(binary()) :: String.t()
  def text_digest(text), do: :sha256 |> :crypto.hash(text) |> Base.encode16()

  @doc """
  Checks that the file still has this digest or was deleted. A dataset that was never in the file (digest `nil`)
  replaces any file.
  """
  @spec check_unchanged(Path.t(), String.t() | nil) :: :ok | {:error, Error.t()}
  def check_unchanged(_path, nil), do: :ok

  def check_unchanged(path, digest) do
    case File.read(path) do
      {:ok, text} -> if text_digest(text) == digest, do: :ok, else: {:error, changed_error(path)}
      {:error, :enoent} -> :ok
      {:error, reason} -> {:error, not_saved_error(path, reason)}
    end
  end

  defp changed_error(path) do
    Error.new(:dataset_changed, "the dataset #{path} has changed since it was read",
      why: "another program saved it, and saving now would discard those edits",
      fix: "reopen it and repeat the edit, or save under another name with `save_as/2`"
    )
  end

  @doc "Writes the file atomically and returns `{:ok, digest}`."
  @spec write(Path.t(), String.t()) :: {:ok, String.t()} | {:error, Error.t()}
  def write(path, text) do
    case AtomicFile.write(path, text) do
      :ok -> {:ok, text_digest(text)}
      {:error, reason} -> {:error, not_saved_error(path, reason)}
    end
  end

  defp not_saved_error(path, reason) do
    Error.new(:not_saved, "cannot save the dataset to #{path}",
      why: to_string(:file.format_error(reason)),
      fix: "the file was not changed; check the folder, or save to another file"
    )
  end
end

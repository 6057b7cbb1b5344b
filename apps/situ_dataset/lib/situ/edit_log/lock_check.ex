defmodule Situ.EditLog.LockCheck do
  @moduledoc false
  # Refuses file systems whose locks do not keep two programs apart. It takes a lock twice, through two descriptions of
  # one file, and reads the options of the mount: some network file systems keep locks on one computer only.
  alias Situ.Error
  alias Situ.Store.FileLock

  @doc "Checks the file system of a folder, once for each device. Error: `:no_locks`."
  @spec check_folder(Path.t(), (Path.t() -> term())) :: :ok | {:error, Error.t()}
  def check_folder(folder, acquire \\ &FileLock.acquire/1) do
    with {:ok, %{major_device: device}} <- File.stat(folder),
         :unknown <- :persistent_term.get({__MODULE__, device}, :unknown),
         :ok <- try_twice(folder, acquire),
         :ok <- check_mount(folder) do
      :persistent_term.put({__MODULE__, device}, :ok)
    else
      {:error, reason} when is_atom(reason) -> :ok
      result -> result
    end
  end

  defp try_twice(folder, acquire) do
    path =
      Path.join(folder, ".situ-lock-check-#{System.pid()}-#{System.unique_integer([:positive])}")

    case acquire.(path) do
      {:ok, lock} ->
        second = acquire.(path)
        :ok = FileLock.release(lock)
        check_second(second, folder)

      {:error, error} ->
        {:error, explain_failure(error, folder)}
    end
  end

  defp check_second({:held, _}, _folder), do: :ok

  defp check_second({:ok, lock}, folder) do
    :ok = FileLock.release(lock)
    {:error, no_locks_error(folder, "two programs would get the same lock at the same time")}
  end

  defp check_second({:error, error}, folder), do: {:error, explain_failure(error, folder)}

  # A folder that cannot be written is a different problem, which the first edit reports.
  defp explain_failure(%Error{code: :no_locks, why: why}, folder),
    do: no_locks_error(folder, why)

  defp explain_failure(error, _folder), do: error

  defp check_mount(folder) do
    with {:ok, mounts} <- File.read("/proc/self/mounts"),
         why when is_binary(why) <- find_problem(mounts, Path.expand(folder)) do
      {:error, no_locks_error(folder, why)}
    else
      _ -> :ok
    end
  end

  @doc """
  Returns why the locks of a folder's file system do not work, or `nil`. `mounts` is the content of `/proc/self/mounts`.

      iex> mounts = "/dev/sda1 / ext4 rw 0 0\\nlab:/data /data nfs rw,vers=3,nolock 0 0\\n"
      iex> Situ.EditLog.LockCheck.find_problem(mounts, "/data/study")
      "the network file system at /data (nfs) is mounted with nolock, so other computers do not see the lock"
      iex> Situ.EditLog.LockCheck.find_problem(mounts, "/home")
      nil
  """
  @spec find_problem(String.t(), Path.t()) :: String.t() | nil
  def find_problem(mounts, folder) do
    mounted =
      for line <- String.split(mounts, "\n", trim: true),
          [_, point, type, options | _] <- [String.split(line)],
          point == "/" or folder == point or String.starts_with?(folder, point <> "/"),
          do: {byte_size(point), point, type, String.split(options, ",")}

    with {_, point, type, options} <- Enum.max(mounted, fn -> nil end),
         option when option != nil <- find_option(type, options),
         do:
           "the network file system at #{point} (#{type}) is mounted with #{option}, " <>
             "so other computers do not see the lock"
  end

  defp find_option("nfs" <> _, options),
    do: Enum.find(options, &(&1 in ~w(nolock local_lock=all local_lock=flock)))

  defp find_option("cifs", options), do: Enum.find(options, &(&1 == "nobrl"))
  defp find_option("fuse.sshfs", _options), do: "sshfs"
  defp find_option(_type, _options), do: nil

  defp no_locks_error(folder, why) do
    Error.new(:no_locks, "cannot edit in #{folder}: its file system has no working locks",
      why: why,
      fix:
        "copy the study to a local disk, or mount the file system with locks (NFS: without nolock and local_lock)"
    )
  end
end

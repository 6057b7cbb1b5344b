defmodule Situ.Store.Volatile do
  @moduledoc """
  Keeps stores in memory: the same files, in the memory file system.

  Any process on the machine can read them while this system is running. They are deleted after it has ended, and are
  never written to disk.
  """

  alias Situ.{Error, Scratch}

  @doc "Returns the folder of this system's stores in memory."
  @spec root() :: Path.t()
  def root do
    case :persistent_term.get(__MODULE__, nil) do
      nil -> make()
      root -> root
    end
  end

  @doc "Returns the newest store in memory of this name, in any running system, or `nil`."
  @spec find(String.t()) :: Path.t() | nil
  def find(name) do
    # Another user may have created a folder of that name. It is not searched.
    folders = if Scratch.claim(base()) == :ok, do: Path.wildcard(Path.join(base(), "*")), else: []

    folders
    |> Enum.map(&Situ.Store.Folder.newest(name, &1))
    |> Enum.reject(&is_nil/1)
    |> Enum.max_by(&File.stat!(&1, time: :posix).mtime, fn -> nil end)
  end

  defp make do
    Error.unwrap!(Scratch.claim(base()))
    sweep()
    root = Path.join(base(), "#{System.pid()}")
    Error.unwrap!(Scratch.claim(root))
    :persistent_term.put(__MODULE__, root)
    root
  end

  # Each folder is named after its process. Folders of processes that have ended are deleted.
  defp sweep do
    for folder <- Path.wildcard(Path.join(base(), "*")),
        pid = Path.basename(folder),
        pid =~ ~r/\A\d+\z/,
        pid != System.pid(),
        not File.exists?("/proc/#{pid}") do
      File.rm_rf(folder)
    end
  end

  defp base do
    memory = "/dev/shm"
    user = System.get_env("USER") || "user"
    root = if File.dir?(memory), do: memory, else: System.tmp_dir!()
    Path.join(root, "situ-#{user}")
  end
end

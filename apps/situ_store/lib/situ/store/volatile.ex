defmodule Situ.Store.Volatile do
  @moduledoc """
  Stores in memory: the same files, in the memory file system.

  They can be read by any process of the machine while this system runs, are swept when it has gone, and never touch a
  disk.
  """

  alias Situ.{Error, Scratch}

  @doc "The folder of this system's stores in memory."
  @spec root() :: Path.t()
  def root do
    case :persistent_term.get(__MODULE__, nil) do
      nil -> make()
      root -> root
    end
  end

  @doc "The newest store in memory of this name, in any running system, or `nil`."
  @spec find(String.t()) :: Path.t() | nil
  def find(name) do
    # Another user may have made a folder of that name: it is not searched.
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

  # Folders are named by the process they belong to; those of processes that have gone are leftovers.
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

defmodule Situ.Store.MemoryStores do
  @moduledoc false
  # Keeps stores in memory: the same files as on disk, in the memory file system. They are deleted
  # after this system has ended.

  alias Situ.{Error, TempFolder}

  @doc "Returns the folder of this system's stores in memory."
  @spec root_folder() :: Path.t()
  def root_folder do
    case :persistent_term.get(__MODULE__, nil) do
      nil -> create_root()
      root -> root
    end
  end

  @doc "Returns the newest store in memory of this name, in any running system, or `nil`."
  @spec find_store(String.t()) :: Path.t() | nil
  def find_store(name) do
    # Another user may have created a folder of that name. It is not searched.
    folders =
      if TempFolder.claim_folder(base_folder()) == :ok,
        do: Path.wildcard(Path.join(base_folder(), "*")),
        else: []

    folders
    |> Enum.map(&Situ.Store.Folder.newest_version(name, &1))
    |> Enum.reject(&is_nil/1)
    |> Enum.max_by(&File.stat!(&1, time: :posix).mtime, fn -> nil end)
  end

  defp create_root do
    Error.unwrap!(TempFolder.claim_folder(base_folder()))
    delete_leftovers()
    root = Path.join(base_folder(), "#{System.pid()}")
    Error.unwrap!(TempFolder.claim_folder(root))
    :persistent_term.put(__MODULE__, root)
    root
  end

  # Each folder is named after its process. Folders of processes that have ended are deleted.
  defp delete_leftovers do
    for folder <- Path.wildcard(Path.join(base_folder(), "*")),
        pid = Path.basename(folder),
        pid =~ ~r/\A\d+\z/,
        pid != System.pid(),
        not File.exists?("/proc/#{pid}") do
      File.rm_rf(folder)
    end
  end

  defp base_folder do
    memory = "/dev/shm"
    user = System.get_env("USER") || "user"
    root = if File.dir?(memory), do: memory, else: System.tmp_dir!()
    Path.join(root, "situ-#{user}")
  end
end

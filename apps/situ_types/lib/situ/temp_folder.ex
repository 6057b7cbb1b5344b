defmodule Situ.TempFolder do
  @moduledoc false
  # Creates private folders for unfinished files, inside temporary folders that all users of the
  # machine share.
  #
  # Each folder is new, has a random name and mode 0700, and belongs to the current user. No other
  # user can have put a file or link into it, so the files inside may have simple names.
  alias Situ.Error

  @private 0o700

  @doc """
  Creates a folder with a random name in `parent` (default: the system's temporary folder). Error:
  `:no_scratch`.

      iex> {:ok, folder} = Situ.TempFolder.create_folder("doc")
      iex> Bitwise.band(File.stat!(folder).mode, 0o777) == 0o700
      true
      iex> Situ.TempFolder.remove_folder(folder)
      :ok
  """
  @spec create_folder(String.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def create_folder(word, parent \\ System.tmp_dir!()) do
    # The name has 96 random bits, in lower case because some file systems ignore case.
    random = Base.encode32(:crypto.strong_rand_bytes(12), case: :lower, padding: false)
    folder = Path.join(parent, "situ-#{word}-#{random}")

    # mkdir fails if the name exists, even as a link. Listing the folder detects files that another user created
    # before its mode was set.
    with :ok <- File.mkdir(folder),
         :ok <- File.chmod(folder, @private),
         {:ok, []} <- File.ls(folder) do
      {:ok, folder}
    else
      {:ok, _found} -> {:error, no_scratch(folder, "another user has put files into it")}
      {:error, reason} -> {:error, no_scratch(folder, to_string(:file.format_error(reason)))}
    end
  end

  @doc "Calls `fun` with a new folder and removes the folder afterwards. Raises if the folder cannot be created."
  @spec with_folder(String.t(), (Path.t() -> result)) :: result when result: term()
  def with_folder(word, fun) do
    folder = Error.unwrap!(create_folder(word))

    try do
      fun.(folder)
    after
      remove_folder(folder)
    end
  end

  @doc "Removes a folder and everything in it."
  @spec remove_folder(Path.t()) :: :ok
  def remove_folder(folder) do
    _ = File.rm_rf(folder)
    :ok
  end

  @doc """
  Creates a folder with a predictable name, or uses an existing one, and sets its mode to 0700. An existing folder
  must belong to the current user and must not be a link. Error: `:no_scratch`.
  """
  @spec claim_folder(Path.t()) :: :ok | {:error, Error.t()}
  def claim_folder(folder) do
    made = File.mkdir(folder)

    with true <- made in [:ok, {:error, :eexist}],
         {:ok, %{type: :directory, uid: uid}} <- File.lstat(folder),
         {:ok, %{uid: ^uid}} <- stat_own_file(),
         :ok <- File.chmod(folder, @private) do
      :ok
    else
      false -> {:error, no_scratch(folder, to_string(:file.format_error(elem(made, 1))))}
      _ -> {:error, no_scratch(folder, "it is a link, or belongs to another user")}
    end
  end

  # The owner of a file that this process created is the current user; Erlang has no function to ask for it.
  defp stat_own_file do
    with {:error, _} <- File.stat("/proc/self") do
      with_folder("own", &File.stat/1)
    end
  end

  defp no_scratch(folder, why) do
    Error.new(:no_scratch, "cannot create the folder #{folder}",
      why: why,
      fix: "set TMPDIR to a folder that only you can write to"
    )
  end
end

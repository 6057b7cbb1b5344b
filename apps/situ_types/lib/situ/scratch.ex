defmodule Situ.Scratch do
  @moduledoc """
  Private folders for unfinished files, below temporary folders that all users of the machine share.

  A folder is new, has a random name and the mode 0700, and belongs to this user: nobody else can have put a file or a
  link into it. So the files inside may have simple names.

      iex> {:ok, folder} = Situ.Scratch.create("doc")
      iex> Bitwise.band(File.stat!(folder).mode, 0o777) == 0o700
      true
      iex> Situ.Scratch.remove(folder)
      :ok
  """
  alias Situ.Error

  @private 0o700

  @doc "Makes a folder with a random name below `parent` (the system's temporary folder). Error: `:no_scratch`."
  @spec create(String.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def create(word, parent \\ System.tmp_dir!()) do
    # 96 bits, in letters that every file system tells apart.
    random = Base.encode32(:crypto.strong_rand_bytes(12), case: :lower, padding: false)
    folder = Path.join(parent, "situ-#{word}-#{random}")

    # mkdir fails if anything has that name, even a link. The listing shows a file that somebody else put into the
    # folder before its mode was set.
    with :ok <- File.mkdir(folder),
         :ok <- File.chmod(folder, @private),
         {:ok, []} <- File.ls(folder) do
      {:ok, folder}
    else
      {:ok, _found} -> {:error, no_scratch(folder, "somebody else has put files into it")}
      {:error, reason} -> {:error, no_scratch(folder, to_string(:file.format_error(reason)))}
    end
  end

  @doc "Calls `fun` with a new folder, and removes the folder afterwards. Raises if it cannot be made."
  @spec with_folder(String.t(), (Path.t() -> result)) :: result when result: term()
  def with_folder(word, fun) do
    folder = Error.unwrap!(create(word))

    try do
      fun.(folder)
    after
      remove(folder)
    end
  end

  @doc "Removes a folder with everything in it."
  @spec remove(Path.t()) :: :ok
  def remove(folder) do
    _ = File.rm_rf(folder)
    :ok
  end

  @doc """
  Makes a folder with a name that others may know, or takes an existing one, which must be a real folder (not a link) of
  this user. Sets its mode to 0700. Error: `:no_scratch`.
  """
  @spec claim(Path.t()) :: :ok | {:error, Error.t()}
  def claim(folder) do
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

  # A file of this process has its user; Erlang has no function for that.
  defp stat_own_file do
    with {:error, _} <- File.stat("/proc/self") do
      with_folder("own", &File.stat/1)
    end
  end

  defp no_scratch(folder, why) do
    Error.new(:no_scratch, "cannot make the folder #{folder}",
      why: why,
      fix: "set TMPDIR to a folder that only you can write to"
    )
  end
end

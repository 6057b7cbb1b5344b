defmodule Situ.Scratch do
  @moduledoc """
  Folders for what is in the making, in temporary folders that other users of the machine share.

  A folder has a random name and the mode 0700, is made anew, and is this user's own: nobody can have put a file or a
  link into it. Names of files inside may be plain.

      iex> {:ok, folder} = Situ.Scratch.create("doc")
      iex> Bitwise.band(File.stat!(folder).mode, 0o777) == 0o700
      true
      iex> Situ.Scratch.remove(folder)
      :ok
  """
  alias Situ.Error

  @private 0o700

  @doc "Makes a folder of a random name below `parent` (the system's temporary folder). Error: `:no_scratch`."
  @spec create(String.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def create(word, parent \\ System.tmp_dir!()) do
    # 96 bits, in letters that every file system tells apart.
    random = Base.encode32(:crypto.strong_rand_bytes(12), case: :lower, padding: false)
    folder = Path.join(parent, "situ-#{word}-#{random}")

    # mkdir fails where anything of that name is, a link included. A file that somebody has put into it before its mode
    # was set is seen.
    with :ok <- File.mkdir(folder),
         :ok <- File.chmod(folder, @private),
         {:ok, []} <- File.ls(folder) do
      {:ok, folder}
    else
      {:ok, _found} -> {:error, no_scratch(folder, "somebody else has put files into it")}
      {:error, reason} -> {:error, no_scratch(folder, to_string(:file.format_error(reason)))}
    end
  end

  @doc "Calls `fun` with such a folder, and removes the folder afterwards. Raises where it cannot be made."
  @spec with_folder(String.t(), (Path.t() -> result)) :: result when result: term()
  def with_folder(word, fun) do
    folder = Error.unwrap!(create(word))

    try do
      fun.(folder)
    after
      remove(folder)
    end
  end

  @doc "Removes such a folder with everything in it."
  @spec remove(Path.t()) :: :ok
  def remove(folder) do
    _ = File.rm_rf(folder)
    :ok
  end

  @doc """
  Makes a folder of a name that is known to everybody, or takes the one that is there: a real folder (not a link) that
  belongs to this user; its mode becomes 0700. Error: `:no_scratch`.
  """
  @spec claim(Path.t()) :: :ok | {:error, Error.t()}
  def claim(folder) do
    made = File.mkdir(folder)

    with true <- made in [:ok, {:error, :eexist}],
         {:ok, %{type: :directory, uid: uid}} <- File.lstat(folder),
         {:ok, %{uid: ^uid}} <- own(),
         :ok <- File.chmod(folder, @private) do
      :ok
    else
      false -> {:error, no_scratch(folder, to_string(:file.format_error(elem(made, 1))))}
      _ -> {:error, no_scratch(folder, "it is a link, or belongs to another user")}
    end
  end

  # A file of this process: Erlang does not say whose process it is.
  defp own do
    with {:error, _} <- File.stat("/proc/self") do
      with_folder("own", &File.stat/1)
    end
  end

  defp no_scratch(folder, why) do
    Error.new(:no_scratch, "cannot make the folder #{folder}",
      why: why,
      fix: "set TMPDIR to a folder of your own"
    )
  end
end

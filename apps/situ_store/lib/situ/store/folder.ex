defmodule Situ.Store.Folder do
  @moduledoc false
  # Where stores lie: root/name.NNNN, the highest number being the newest.
  alias Situ.Error
  alias Situ.Store.{AtomicFile, Failure, Formats, Native}

  @index "index.situ"

  @spec store?(Path.t()) :: boolean()
  def store?(path) do
    File.exists?(Path.join(path, @index)) or File.exists?(Path.join(path, "data-000000.situ"))
  end

  @unfinished ".unfinished"

  @doc "The ending of an unfinished folder's name."
  @spec unfinished() :: String.t()
  def unfinished, do: @unfinished

  @doc "Whether a folder is an unfinished one."
  @spec unfinished?(Path.t()) :: boolean()
  def unfinished?(path), do: String.ends_with?(path, @unfinished)

  @doc "A new folder for store `name` below `root`; with a `mode` (of its files) only those it names may enter."
  @spec create(String.t(), Path.t(), boolean(), non_neg_integer() | nil) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def create(name, root, versioned?, mode \\ nil) do
    # A folder that was there before is somebody's.
    ours? = versioned? or not File.exists?(root)

    with :ok <- check_name(name),
         :ok <- check_mode(mode),
         {:ok, path} <- made(name, root, versioned?),
         :ok <- if(ours?, do: restrict(path, mode), else: :ok),
         do: {:ok, path}
  end

  defp made(name, root, true), do: create_version(name, root, next(name, root))
  defp made(_name, root, false), do: create_plain(root)

  # The files' owner, and a group that reads.
  @mode 0o640

  @doc "The mode of a copy of these recordings when nobody says another: no wider than any of them; `nil` is the usual."
  @spec mode_of([Path.t()]) :: non_neg_integer() | nil
  def mode_of(paths) do
    modes = for path <- paths, {:ok, stat} <- [File.stat(file(path))], do: stat.mode
    mode = Enum.reduce(modes, @mode, &Bitwise.band/2)
    if mode == @mode, do: nil, else: Bitwise.bor(mode, 0o600)
  end

  @doc "Gives a store's files, and its folder, the modes that those of another have."
  @spec keep_mode(Path.t(), Path.t()) :: :ok | {:error, Error.t()}
  def keep_mode(path, like) do
    mode = File.stat!(file(like)).mode
    for name <- File.ls!(path), do: File.chmod!(Path.join(path, name), Bitwise.band(mode, 0o777))
    File.chmod!(path, Bitwise.band(File.stat!(like).mode, 0o777))
  rescue
    error in File.Error ->
      {:error, Error.new(:io, "cannot set the mode of #{path}", why: Exception.message(error))}
  end

  defp file(path), do: if(File.dir?(path), do: Path.join(path, @index), else: path)

  # The files have their mode from the first moment on; the folder is empty until it has its own.
  defp restrict(path, mode) do
    wanted = entering(mode || @mode)

    with {:ok, %{mode: now}} <- File.stat(path),
         # Without a mode of its own the process's mask holds, too.
         :ok <- File.chmod(path, if(mode, do: wanted, else: Bitwise.band(now, wanted))) do
      :ok
    else
      {:error, reason} -> mkdir(path, fn -> {:error, reason} end)
    end
  end

  # Who reads a folder's files has to enter it.
  defp entering(mode), do: Bitwise.bor(mode, Bitwise.bsr(Bitwise.band(mode, 0o444), 2))

  defp check_mode(nil), do: :ok
  defp check_mode(mode) when mode <= 0o777 and Bitwise.band(mode, 0o600) == 0o600, do: :ok

  defp check_mode(mode) do
    {:error,
     Error.new(:bad_mode, "no recording can have the mode 0o#{Integer.to_string(mode, 8)}",
       why: "its owner has to read and write it, and a mode has nine bits",
       fix: "use 0o600, 0o640, 0o644, 0o660 ..."
     )}
  end

  defp create_plain(root) do
    cond do
      store?(root) ->
        {:error,
         Error.new(:store_exists, "there is a store in #{root} already",
           fix: "leave `versioned: true`, or choose another folder"
         )}

      true ->
        mkdir(root, fn -> parent(root) end)
    end
  end

  defp create_version(name, root, version) do
    path = Path.join(root, "#{name}.#{pad(version)}")

    with :ok <- parent(Path.dirname(path)),
         # Another process took this number: the next one is ours.
         {:error, :eexist} <- File.mkdir(path),
         true <- File.dir?(Path.dirname(path)) do
      create_version(name, root, version + 1)
    else
      false -> mkdir(path, fn -> {:error, :enotdir} end)
      result -> mkdir(path, fn -> result end)
    end
  end

  # A file in the place of the folder gives "exists", which does not help anybody.
  defp parent(path) do
    with {:error, :eexist} <- AtomicFile.make_folder(path), do: {:error, :enotdir}
  end

  @doc "Makes the parent folders of a store that will be at `path`."
  @spec make_parents(Path.t()) :: :ok | {:error, Error.t()}
  def make_parents(path) do
    with {:ok, _} <- mkdir(Path.dirname(path), fn -> parent(Path.dirname(path)) end), do: :ok
  end

  @doc "Gives a finished store the name of the next version of `name` below `root`, in one step: `{:ok, path}`."
  @spec place_version(Path.t(), String.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def place_version(from, name, root) do
    with :ok <- check_name(name),
         do: place_version(from, name, root, next(name, root))
  end

  defp place_version(from, name, root, version) do
    path = Path.join(root, "#{name}.#{pad(version)}")

    case Native.rename_new(from, path) do
      :ok ->
        AtomicFile.sync_folder(root)
        {:ok, path}

      # Another process took this number: the next one is ours.
      :exists ->
        place_version(from, name, root, version + 1)

      :unsupported ->
        place_over(from, name, root)

      {:error, reason} ->
        {:error, Failure.error(reason, path)}
    end
  end

  # An empty folder keeps the name for us until the store takes its place.
  defp place_over(from, name, root) do
    with {:ok, path} <- create_version(name, root, next(name, root)) do
      case AtomicFile.rename(from, path) do
        :ok -> {:ok, path}
        {:error, reason} -> {:error, io_error("give #{from} its name", reason)}
      end
    end
  end

  @doc "An error of an operation on files: `what` could not be done."
  @spec io_error(String.t(), File.posix()) :: Error.t()
  def io_error(what, reason) do
    Error.new(code(reason), "cannot #{what}",
      why: to_string(:file.format_error(reason)),
      fix: "check the folder and its permissions"
    )
  end

  defp mkdir(path, make) do
    case make.() do
      :ok ->
        {:ok, path}

      {:error, reason} ->
        {:error,
         Error.new(code(reason), "cannot make the folder #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "check the path and its permissions"
         )}
    end
  end

  defp code(reason) when reason in [:eacces, :erofs, :eperm], do: :not_permitted
  defp code(:enospc), do: :disk_full
  defp code(_), do: :io

  @doc "The folder of the newest version of `name` below `root`, or `nil`."
  @spec newest(String.t(), Path.t()) :: Path.t() | nil
  def newest(name, root) do
    case versions(name, root) do
      [] -> nil
      versions -> newest_of(Enum.sort(versions, :desc), name, root)
    end
  end

  # A writer that was killed before it had a file leaves an empty folder. It must not hide an older recording.
  defp newest_of(versions, name, root) do
    paths = for version <- versions, do: Path.join(root, "#{name}.#{pad(version)}")
    Enum.find(paths, hd(paths), &(File.ls(&1) != {:ok, []}))
  end

  @doc "The folders of all versions of `name` below `root`, oldest first."
  @spec list_versions(String.t(), Path.t()) :: [Path.t()]
  def list_versions(name, root) do
    for version <- name |> versions(root) |> Enum.sort(),
        do: Path.join(root, "#{name}.#{pad(version)}")
  end

  @doc "The bytes of a store's files, including bytes allocated for later messages."
  @spec size(Path.t()) :: non_neg_integer()
  def size(path) do
    for file <- ls(path),
        String.ends_with?(file, ".situ"),
        {:ok, %{size: size}} <- [File.stat(Path.join(path, file))],
        reduce: 0 do
      sum -> sum + size
    end
  end

  defp ls(path) do
    case File.ls(path) do
      {:ok, names} -> names
      {:error, _} -> []
    end
  end

  @doc "The store that `path` means: the folder itself, or the newest version of its last name."
  @spec resolve(Path.t()) :: Path.t() | nil
  def resolve(path) do
    if store?(path), do: path, else: newest(Path.basename(path), Path.dirname(path))
  end

  @doc "All stores below `root`, by path; foreign ones that are folders too."
  @spec all(Path.t(), boolean()) :: [Path.t()]
  def all(root, recursive?) do
    case File.ls(root) do
      {:error, _} ->
        []

      {:ok, names} ->
        dirs = names |> Enum.sort() |> Enum.map(&Path.join(root, &1)) |> Enum.filter(&File.dir?/1)
        (Formats.within(root) -- [root]) ++ Enum.flat_map(dirs, &in_folder(&1, recursive?))
    end
  end

  defp in_folder(dir, recursive?) do
    cond do
      unfinished?(dir) -> []
      store?(dir) -> [dir]
      dir in Formats.within(dir) -> [dir]
      recursive? -> all(dir, true)
      true -> []
    end
  end

  @doc "Deletes a store's files, and its folder when nothing else is in it."
  @spec remove(Path.t()) :: :ok | {:error, Error.t()}
  def remove(folder) do
    folder
    |> File.ls!()
    |> Enum.filter(
      &(&1 =~
          ~r/\A(index\.situ.*|data-\d+\.situ|large-\d+\.situ|lock|(data|large)-\d+\.situ\.before-repair.*)\z/)
    )
    |> Enum.each(&File.rm!(Path.join(folder, &1)))

    # Someone's notes beside the recording stay, and with them the folder.
    _ = File.rmdir(folder)
    :ok
  rescue
    error in File.Error ->
      {:error, Error.new(:io, "cannot delete #{folder}", why: Exception.message(error))}
  end

  @doc "The store's name as its folder has it."
  @spec name(Path.t()) :: String.t()
  def name(path), do: path |> Path.basename() |> String.replace(~r/\.\d{4,}$/, "")

  @doc """
  The current name of the store in a folder; `made_as` is the name that its catalog has from when it was made. A folder
  NAME.NNNN may have been renamed since, so its own name counts. Any other folder says nothing about the name.
  """
  @spec own_name(Path.t(), term()) :: String.t()
  def own_name(path, made_as) do
    if version(path) != nil or not (is_binary(made_as) and String.valid?(made_as)),
      do: name(path),
      else: made_as
  end

  @doc "The version number of a store's folder, or `nil`."
  @spec version(Path.t()) :: non_neg_integer() | nil
  def version(path) do
    case Regex.run(~r/\.(\d{4,})$/, Path.basename(path)) do
      [_, digits] -> String.to_integer(digits)
      nil -> nil
    end
  end

  defp next(name, root), do: Enum.max(versions(name, root), fn -> -1 end) + 1

  defp versions(name, root) do
    case File.ls(root) do
      {:ok, entries} ->
        for entry <- entries,
            String.starts_with?(entry, name <> "."),
            suffix =
              binary_part(entry, byte_size(name) + 1, byte_size(entry) - byte_size(name) - 1),
            suffix =~ ~r/\A\d{4,9}\z/,
            do: String.to_integer(suffix)

      {:error, _} ->
        []
    end
  end

  defp pad(version), do: version |> Integer.to_string() |> String.pad_leading(4, "0")

  @doc "Whether a store can have this name."
  @spec check_name(term()) :: :ok | {:error, Error.t()}
  def check_name(name) do
    if is_binary(name) and name =~ ~r/\A[^\/\0]{1,200}\z/ and name not in [".", ".."] do
      :ok
    else
      {:error,
       Error.new(:bad_name, "not a name for a store: #{inspect(name)}",
         fix: "use 1 to 200 characters without \"/\""
       )}
    end
  end
end

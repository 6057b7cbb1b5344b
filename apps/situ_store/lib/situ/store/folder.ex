defmodule Situ.Store.Folder do
  @moduledoc false
  # Locates stores at root/name.NNNN, where the highest number is the newest version.
  alias Situ.Error
  alias Situ.Recording.Formats
  alias Situ.Store.{AtomicFile, NativeErrors, Native}

  @index "index.situ"

  @spec store_folder?(Path.t()) :: boolean()
  def store_folder?(path) do
    File.exists?(Path.join(path, @index)) or File.exists?(Path.join(path, "data-000000.situ"))
  end

  @unfinished ".unfinished"

  @doc "Returns the suffix of an unfinished folder's name."
  @spec unfinished_suffix() :: String.t()
  def unfinished_suffix, do: @unfinished

  @doc "Returns whether a folder is unfinished."
  @spec unfinished?(Path.t()) :: boolean()
  def unfinished?(path), do: String.ends_with?(path, @unfinished)

  @doc "Creates a folder for store `name` in `root`. `mode` is the mode of its files and also restricts the folder."
  @spec create_store_folder(String.t(), Path.t(), boolean(), non_neg_integer() | nil) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def create_store_folder(name, root, versioned?, mode \\ nil) do
    # An existing folder belongs to the user, so its mode is not changed.
    ours? = versioned? or not File.exists?(root)

    with :ok <- check_name(name),
         :ok <- check_mode(mode),
         {:ok, path} <- make_store_folder(name, root, versioned?),
         :ok <- if(ours?, do: restrict_mode(path, mode), else: :ok),
         do: {:ok, path}
  end

  defp make_store_folder(name, root, true),
    do: create_version(name, root, next_version(name, root))

  defp make_store_folder(_name, root, false), do: create_plain(root)

  # The owner may read and write; the group may read.
  @mode 0o640

  @doc "Returns the mode for a copy of these recordings: the narrowest of theirs, or `nil` for the usual mode."
  @spec mode_of([Path.t()]) :: non_neg_integer() | nil
  def mode_of(paths) do
    modes = for path <- paths, {:ok, stat} <- [File.stat(index_file(path))], do: stat.mode
    mode = Enum.reduce(modes, @mode, &Bitwise.band/2)
    if mode == @mode, do: nil, else: Bitwise.bor(mode, 0o600)
  end

  @doc "Gives a store's files and folder the modes of the files and folder of another store."
  @spec keep_mode(Path.t(), Path.t()) :: :ok | {:error, Error.t()}
  def keep_mode(path, like) do
    mode = File.stat!(index_file(like)).mode
    for name <- File.ls!(path), do: File.chmod!(Path.join(path, name), Bitwise.band(mode, 0o777))
    File.chmod!(path, Bitwise.band(File.stat!(like).mode, 0o777))
  rescue
    error in File.Error ->
      {:error,
       Error.new(:io, "cannot set the file mode of #{path}", why: Exception.message(error))}
  end

  defp index_file(path), do: if(File.dir?(path), do: Path.join(path, @index), else: path)

  # Files are created with their mode, and the folder is still empty when its mode is set.
  defp restrict_mode(path, mode) do
    wanted = add_search_bits(mode || @mode)

    with {:ok, %{mode: now}} <- File.stat(path),
         # Without an explicit mode, the process's file mode mask also applies.
         :ok <- File.chmod(path, if(mode, do: wanted, else: Bitwise.band(now, wanted))) do
      :ok
    else
      {:error, reason} -> wrap_folder_error(path, fn -> {:error, reason} end)
    end
  end

  # Reading a file in a folder requires search permission on the folder.
  defp add_search_bits(mode), do: Bitwise.bor(mode, Bitwise.bsr(Bitwise.band(mode, 0o444), 2))

  defp check_mode(nil), do: :ok
  defp check_mode(mode) when mode <= 0o777 and Bitwise.band(mode, 0o600) == 0o600, do: :ok

  defp check_mode(mode) do
    {:error,
     Error.new(:bad_mode, "invalid file mode 0o#{Integer.to_string(mode, 8)}",
       why: "a mode has nine bits, and the owner must be able to read and write",
       fix: "use 0o600, 0o640, 0o644, 0o660 ..."
     )}
  end

  defp create_plain(root) do
    cond do
      store_folder?(root) ->
        {:error,
         Error.new(:store_exists, "#{root} already contains a store",
           fix: "keep `versioned: true`, or choose another folder"
         )}

      true ->
        wrap_folder_error(root, fn -> make_parent(root) end)
    end
  end

  defp create_version(name, root, version) do
    path = Path.join(root, "#{name}.#{format_version(version)}")

    with :ok <- make_parent(Path.dirname(path)),
         # Another process took this number, so try the next one.
         {:error, :eexist} <- File.mkdir(path),
         true <- File.dir?(Path.dirname(path)) do
      create_version(name, root, version + 1)
    else
      false -> wrap_folder_error(path, fn -> {:error, :enotdir} end)
      result -> wrap_folder_error(path, fn -> result end)
    end
  end

  # If the path is a file, "not a directory" is more helpful than "exists".
  defp make_parent(path) do
    with {:error, :eexist} <- AtomicFile.make_folder(path), do: {:error, :enotdir}
  end

  @doc "Creates the parent folders of a store at `path`."
  @spec make_parents(Path.t()) :: :ok | {:error, Error.t()}
  def make_parents(path) do
    with {:ok, _} <-
           wrap_folder_error(Path.dirname(path), fn -> make_parent(Path.dirname(path)) end),
         do: :ok
  end

  @doc "Renames a finished store to the next version of `name` in `root`, in one step: `{:ok, path}`."
  @spec place_version(Path.t(), String.t(), Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def place_version(from, name, root) do
    with :ok <- check_name(name),
         do: place_version(from, name, root, next_version(name, root))
  end

  defp place_version(from, name, root, version) do
    path = Path.join(root, "#{name}.#{format_version(version)}")

    case Native.rename_new(from, path) do
      :ok ->
        AtomicFile.sync_folder(root)
        {:ok, path}

      # Another process took this number, so try the next one.
      :exists ->
        place_version(from, name, root, version + 1)

      :unsupported ->
        place_over_empty(from, name, root)

      {:error, reason} ->
        {:error, NativeErrors.to_error(reason, path)}
    end
  end

  # An empty folder reserves the name until the store replaces it.
  defp place_over_empty(from, name, root) do
    with {:ok, path} <- create_version(name, root, next_version(name, root)) do
      case AtomicFile.rename_synced(from, path) do
        :ok -> {:ok, path}
        {:error, reason} -> {:error, io_error("rename #{from}", reason)}
      end
    end
  end

  @doc "Returns the error for a file operation, where `what` is the operation that failed."
  @spec io_error(String.t(), File.posix()) :: Error.t()
  def io_error(what, reason) do
    Error.new(error_code(reason), "cannot #{what}",
      why: to_string(:file.format_error(reason)),
      fix: "check the folder and its permissions"
    )
  end

  defp wrap_folder_error(path, make) do
    case make.() do
      :ok ->
        {:ok, path}

      {:error, reason} ->
        {:error,
         Error.new(error_code(reason), "cannot create the folder #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "check the path and its permissions"
         )}
    end
  end

  defp error_code(reason) when reason in [:eacces, :erofs, :eperm], do: :not_permitted
  defp error_code(:enospc), do: :disk_full
  defp error_code(_), do: :io

  @doc "Returns the folder of the newest version of `name` in `root`, or `nil`."
  @spec newest_version(String.t(), Path.t()) :: Path.t() | nil
  def newest_version(name, root) do
    case version_numbers(name, root) do
      [] -> nil
      versions -> newest_nonempty(Enum.sort(versions, :desc), name, root)
    end
  end

  # A writer that was killed before it created a file leaves an empty folder, which must not hide an older recording.
  defp newest_nonempty(versions, name, root) do
    paths = for version <- versions, do: Path.join(root, "#{name}.#{format_version(version)}")
    Enum.find(paths, hd(paths), &(File.ls(&1) != {:ok, []}))
  end

  @doc "Lists the folders of all versions of `name` in `root`, oldest first."
  @spec list_versions(String.t(), Path.t()) :: [Path.t()]
  def list_versions(name, root) do
    for version <- name |> version_numbers(root) |> Enum.sort(),
        do: Path.join(root, "#{name}.#{format_version(version)}")
  end

  @doc "Returns the total size of a store's files in bytes, including space allocated for later messages."
  @spec total_size(Path.t()) :: non_neg_integer()
  def total_size(path) do
    for file <- list_files(path),
        String.ends_with?(file, ".situ"),
        {:ok, %{size: size}} <- [File.stat(Path.join(path, file))],
        reduce: 0 do
      sum -> sum + size
    end
  end

  defp list_files(path) do
    case File.ls(path) do
      {:ok, names} -> names
      {:error, _} -> []
    end
  end

  @doc "Returns the store at `path`, which is the folder itself or the newest version of that name, or `nil`."
  @spec resolve_store(Path.t()) :: Path.t() | nil
  def resolve_store(path) do
    if store_folder?(path),
      do: path,
      else: newest_version(Path.basename(path), Path.dirname(path))
  end

  @doc """
  Lists all stores in `root`, sorted by path, including external recordings that are folders. Symbolic links are
  followed, but not back to a folder that contains them.
  """
  @spec list_stores(Path.t(), boolean()) :: [Path.t()]
  def list_stores(root, recursive?), do: list_stores(root, recursive?, identify_folder(root))

  defp list_stores(root, recursive?, above) do
    (Formats.list_recordings(root) -- [root]) ++
      Enum.flat_map(list_folders(root, above), &stores_in(&1, recursive?, above))
  end

  defp stores_in(dir, recursive?, above) do
    cond do
      unfinished?(dir) -> []
      store_folder?(dir) -> [dir]
      dir in Formats.list_recordings(dir) -> [dir]
      recursive? -> list_stores(dir, true, identify_folder(dir) ++ above)
      true -> []
    end
  end

  @doc """
  Lists the files below `root` that open as recordings, by their extensions, sorted by path. JSON files are left out,
  because few of them are recordings.
  """
  @spec list_readable_files(Path.t()) :: [Path.t()]
  def list_readable_files(root),
    do: root |> list_readable_files(identify_folder(root)) |> Enum.sort()

  defp list_readable_files(root, above) do
    files = for name <- list_files(root), path = Path.join(root, name), readable?(path), do: path

    files ++
      for dir <- list_folders(root, above),
          not unfinished?(dir) and not store_folder?(dir),
          file <- list_readable_files(dir, identify_folder(dir) ++ above),
          do: file
  end

  defp readable?(path),
    do: Path.extname(path) != ".json" and Formats.for_file(path) != nil and File.regular?(path)

  # The folders in `root` that are not above it.
  defp list_folders(root, above) do
    for name <- root |> list_files() |> Enum.sort(),
        dir = Path.join(root, name),
        File.dir?(dir),
        identify_folder(dir) -- above != [],
        do: dir
  end

  defp identify_folder(dir) do
    case File.stat(dir) do
      {:ok, %{major_device: device, inode: inode}} -> [{device, inode}]
      {:error, _} -> []
    end
  end

  @doc "Deletes a store's files, and also its folder if it contains nothing else."
  @spec remove_store(Path.t()) :: :ok | {:error, Error.t()}
  def remove_store(folder) do
    folder
    |> File.ls!()
    |> Enum.filter(
      &(&1 =~
          ~r/\A(index\.situ.*|data-\d+\.situ|large-\d+\.situ|lock|(data|large)-\d+\.situ\.before-repair.*)\z/)
    )
    |> Enum.each(&File.rm!(Path.join(folder, &1)))

    # The folder remains if it contains other files, such as a user's notes.
    _ = File.rmdir(folder)
    :ok
  rescue
    error in File.Error ->
      {:error, Error.new(:io, "cannot delete #{folder}", why: Exception.message(error))}
  end

  @doc "Returns the store's name according to its folder."
  @spec store_name(Path.t()) :: String.t()
  def store_name(path), do: path |> Path.basename() |> String.replace(~r/\.\d{4,}$/, "")

  @doc """
  Returns the current name of the store in a folder. `made_as` is the original name from its catalog. A folder NAME.NNNN
  may have been renamed since, so its own name takes precedence. Other folder names say nothing about the store's name.
  """
  @spec current_name(Path.t(), term()) :: String.t()
  def current_name(path, made_as) do
    if version_number(path) != nil or not (is_binary(made_as) and String.valid?(made_as)),
      do: store_name(path),
      else: made_as
  end

  @doc "Returns the version number of a store's folder, or `nil`."
  @spec version_number(Path.t()) :: non_neg_integer() | nil
  def version_number(path) do
    case Regex.run(~r/\.(\d{4,})$/, Path.basename(path)) do
      [_, digits] -> String.to_integer(digits)
      nil -> nil
    end
  end

  defp next_version(name, root), do: Enum.max(version_numbers(name, root), fn -> -1 end) + 1

  defp version_numbers(name, root) do
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

  defp format_version(version), do: version |> Integer.to_string() |> String.pad_leading(4, "0")

  @doc "Checks whether a store can have this name."
  @spec check_name(term()) :: :ok | {:error, Error.t()}
  def check_name(name) do
    if is_binary(name) and name =~ ~r/\A[^\/\0]{1,200}\z/ and name not in [".", ".."] do
      :ok
    else
      {:error,
       Error.new(:bad_name, "invalid store name: #{inspect(name)}",
         fix: "use 1 to 200 characters without \"/\""
       )}
    end
  end
end

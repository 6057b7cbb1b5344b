defmodule Situ.Store.Moving do
  @moduledoc false
  # Moves a recording to another folder: all of its segments, and the annotations and bookmarks next to it. During that
  # time, a file `NAME.moving` with the plan exists in both folders. A program that opens the recording learns that it
  # is incomplete, and the same command completes it if the program is killed. On another file system, everything is
  # copied before the first name changes, and the originals are deleted last.
  # See docs/adr/0207-a-recording-moves-with-everything-next-to-it.md.
  alias Situ.Error

  alias Situ.Store.{
    AtomicFile,
    Draft,
    FileLock,
    Folder,
    Maintenance,
    MovePlan,
    Native,
    NativeErrors,
    Segments
  }

  # The studio's files next to a recording have names that begin with the recording's name and an ending of this list.
  @companions ["-annotation-", ".bookmarks"]
  @lock_ms 5_000
  @options [
    progress: [
      type: {:fun, 2},
      doc:
        "Called as `fun.(done, total)` with bytes, while files are copied to another file system."
    ],
    finish: [
      type: {:fun, 1},
      doc:
        "Called as `fun.([{old, new}])` with all paths before the move ends; returns `:ok` or an error."
    ]
  ]

  @spec move_options() :: Situ.Options.schema()
  def move_options, do: @options

  @spec move(Path.t(), Path.t(), keyword()) :: {:ok, Path.t()} | {:error, Error.t()}
  def move(path, folder, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @options),
         :ok <- check_local([path, folder]) do
      {path, folder} = {Path.expand(path), Path.expand(folder)}

      case MovePlan.find_plan(path, folder) do
        nil -> begin_move(path, folder, opts)
        %{to: ^folder} = plan -> with_locks(plan, fn -> run_plan(plan, opts) end)
        plan -> {:error, MovePlan.interrupted_error(plan)}
      end
    end
  end

  defp check_local(paths) do
    case Enum.find(paths, &(&1 =~ ~r/\A[a-z][a-z0-9+.-]+:\/\//)) do
      nil ->
        :ok

      address ->
        {:error,
         Error.new(:not_local, "#{address} cannot be moved",
           why: "only recordings in folders can be moved",
           fix: "use `situ store push` or `situ store pull`, and delete the original"
         )}
    end
  end

  defp begin_move(path, folder, opts) do
    with {:ok, plan} <- build_plan(path, folder),
         :ok <- check_free(plan),
         :ok <- make_folder(folder),
         do: with_locks(plan, fn -> copy_and_run(plan, opts) end)
  end

  defp copy_and_run(plan, opts) do
    with {:ok, plan} <-
           if(same_file_system?(plan), do: {:ok, plan}, else: stage_entries(plan, opts)),
         do: run_plan(plan, opts)
  end

  @doc "Lists what a move would move. Errors: `:no_store`, `:locked`, and `:same_folder`."
  @spec build_plan(Path.t(), Path.t()) :: {:ok, MovePlan.t()} | {:error, Error.t()}
  def build_plan(path, folder) do
    with {:ok, pieces} <- Maintenance.list_idle_folders(path) do
      {recording, pieces} = list_pieces(path, pieces)
      {root, name} = {Path.dirname(recording), Path.basename(recording)}
      entries = Enum.map(pieces, &Path.basename/1) ++ list_companions(root, name)
      plan = %{from: root, to: folder, name: name, entries: entries, staged: %{}}
      if root == folder, do: {:error, same_folder_error(plan)}, else: {:ok, plan}
    end
  end

  # The versions of a layer of annotations belong together, because its log of edits refers to them.
  defp list_pieces(path, [folder | _] = pieces) do
    {root, name} = {Path.dirname(folder), Folder.store_name(folder)}
    base = Path.join(root, name)

    cond do
      Segments.segmented?(path) ->
        {path, Segments.list_possible_folders(path)}

      logs = list_logs(root, name) ->
        {base, Folder.list_versions(name, root) ++ logs}

      true ->
        {folder, pieces}
    end
  end

  # NAME.STREAM.edits, but not the edit logs of a recording: NAME.NNNN.bookmarks.edits, NAME.NNNN-annotation-S.S.edits.
  defp list_logs(root, name) do
    logs =
      for entry <- list_entries(root),
          String.starts_with?(entry, name <> "."),
          rest = String.replace_prefix(entry, name, ""),
          rest =~ ~r/\A\.(?!\d{4,}[.-]|bookmarks).+\.edits\z/,
          do: Path.join(root, entry)

    if logs != [], do: logs
  end

  defp same_folder_error(plan) do
    Error.new(:same_folder, "#{plan.name} is in #{plan.to} already",
      fix: "choose another folder, or give it another name with `situ store rename`"
    )
  end

  defp list_companions(root, name) do
    for entry <- list_entries(root),
        Enum.any?(@companions, &String.starts_with?(entry, name <> &1)),
        not Folder.unfinished?(entry),
        not String.ends_with?(entry, ".lock"),
        do: entry
  end

  defp list_entries(root) do
    case File.ls(root) do
      {:ok, names} -> Enum.sort(names)
      {:error, _} -> []
    end
  end

  # A set would mix with other segments of its name.
  defp check_free(%{to: to} = plan) do
    taken = Enum.find(plan.entries, &File.exists?(Path.join(to, &1)))
    versions = if plan.name in plan.entries, do: [], else: Folder.list_versions(plan.name, to)

    case taken || List.first(Enum.map(versions, &Path.basename/1)) do
      nil ->
        :ok

      entry ->
        {:error,
         Error.new(:store_exists, "#{Path.join(to, entry)} exists",
           why: "a recording that moves keeps its names",
           fix: "rename the recording first, with `situ store rename`"
         )}
    end
  end

  defp make_folder(folder) do
    with {:error, reason} <- AtomicFile.make_folder(folder),
         do: {:error, Folder.io_error("create the folder #{folder}", reason)}
  end

  # Nobody edits annotations or bookmarks while they move.
  defp with_locks(plan, fun) do
    documents =
      for entry <- plan.entries,
          String.ends_with?(entry, ".edits"),
          path = Path.join(plan.from, String.replace_suffix(entry, ".edits", "")),
          do: path <> ".lock"

    case acquire_locks(documents, []) do
      {:ok, locks} ->
        result = fun.()
        Enum.each(locks, &FileLock.release/1)
        result

      error ->
        error
    end
  end

  defp acquire_locks([], locks), do: {:ok, locks}

  defp acquire_locks([path | paths], locks) do
    case FileLock.acquire(path, @lock_ms) do
      {:ok, lock} ->
        acquire_locks(paths, [lock | locks])

      problem ->
        Enum.each(locks, &FileLock.release/1)
        lock_error(path, problem)
    end
  end

  defp lock_error(_path, {:error, _} = error), do: error

  defp lock_error(path, {:held, holder}) do
    {:error,
     Error.new(:in_use, "#{Path.rootname(path)} is being edited",
       why: FileLock.describe_holder(holder),
       fix: "try again when that program has finished"
     )}
  end

  # Mounts can have the same device, so this tries a rename.
  defp same_file_system?(plan) do
    probe = "#{plan.name}.#{System.pid()}-#{System.unique_integer([:positive])}.tmp"
    {from, to} = {Path.join(plan.from, probe), Path.join(plan.to, probe)}
    written = File.write(from, "")
    renamed = if written == :ok, do: File.rename(from, to), else: written
    Enum.each([from, to], &File.rm/1)
    renamed != {:error, :exdev}
  end

  @doc "Copies the entries into the other folder, under names that are not recordings."
  @spec stage_entries(MovePlan.t(), keyword()) :: {:ok, MovePlan.t()} | {:error, Error.t()}
  def stage_entries(plan, opts \\ []) do
    total = plan.entries |> Enum.map(&entry_size(Path.join(plan.from, &1))) |> Enum.sum()
    report = opts[:progress] || fn _, _ -> :ok end

    plan.entries
    |> Enum.reduce_while({:ok, plan, 0}, fn entry, {:ok, plan, done} ->
      staged = plan.to |> Path.join(entry) |> Draft.unfinished_path() |> Path.basename()
      source = Path.join(plan.from, entry)

      case copy_entry(source, Path.join(plan.to, staged)) do
        :ok ->
          done = done + entry_size(source)
          report.(done, total)
          {:cont, {:ok, put_in(plan.staged[entry], staged), done}}

        {:error, reason} ->
          remove_copies(%{plan | staged: Map.put(plan.staged, entry, staged)})
          {:halt, {:error, Folder.io_error("copy #{source} to #{plan.to}", reason)}}
      end
    end)
    |> case do
      {:ok, plan, _done} -> {:ok, plan}
      error -> error
    end
  end

  defp entry_size(path) do
    files =
      if File.dir?(path), do: Enum.map(list_entries(path), &Path.join(path, &1)), else: [path]

    for file <- files,
        {:ok, %{size: size}} <- [File.stat(file)],
        reduce: 0,
        do: (sum -> sum + size)
  end

  defp remove_copies(plan),
    do: for({_, staged} <- plan.staged, do: File.rm_rf(Path.join(plan.to, staged)))

  defp copy_entry(source, copy) do
    with {:ok, _} <- copy_files(source, copy), :ok <- sync_entry(copy) do
      AtomicFile.sync_folder(Path.dirname(copy))
    end
  end

  defp copy_files(source, copy) do
    case File.cp_r(source, copy) do
      {:ok, files} -> with :ok <- File.chmod(copy, File.stat!(source).mode), do: {:ok, files}
      {:error, reason, _file} -> {:error, reason}
    end
  end

  defp sync_entry(path),
    do: if(File.dir?(path), do: AtomicFile.sync_files(path), else: AtomicFile.sync_file(path))

  defp run_plan(plan, opts) do
    plan
    |> list_steps()
    |> Enum.reduce_while({:ok, Path.join(plan.to, plan.name)}, fn step, done ->
      case run_step(step, plan, opts) do
        :ok -> {:cont, done}
        error -> {:halt, error}
      end
    end)
  end

  @doc "Returns the steps of a move, in order. A program may be killed between any two of them."
  @spec list_steps(MovePlan.t()) :: [term()]
  def list_steps(plan) do
    places = for entry <- plan.entries, do: {:place, entry}
    removals = for entry <- plan.entries, is_map_key(plan.staged, entry), do: {:remove, entry}

    [{:note, plan.to}, {:note, plan.from}] ++
      places ++ removals ++ [:finish, {:forget, plan.from}, {:forget, plan.to}]
  end

  @doc "Performs a step, unless it was performed already."
  @spec run_step(term(), MovePlan.t(), keyword()) :: :ok | {:error, Error.t()}
  def run_step(step, plan, opts \\ [])

  def run_step({:note, root}, plan, _opts), do: MovePlan.write_note(plan, root)

  def run_step({:place, entry}, plan, _opts) do
    {source, target} = {Path.join(plan.from, entry), Path.join(plan.to, entry)}
    staged = plan.staged[entry] && Path.join(plan.to, plan.staged[entry])

    cond do
      File.exists?(target) -> :ok
      staged == nil -> rename_new(source, target)
      File.exists?(staged) -> rename_new(staged, target)
      true -> with :ok <- copy_again(source, staged), do: rename_new(staged, target)
    end
  end

  # The original is deleted only after its copy has its name.
  def run_step({:remove, entry}, plan, _opts) do
    source = Path.join(plan.from, entry)
    hidden = source <> ".moved" <> Folder.unfinished_suffix()

    with true <- File.exists?(Path.join(plan.to, entry)),
         _ = if(File.exists?(source), do: AtomicFile.rename_synced(source, hidden)),
         {:ok, _} <- File.rm_rf(hidden),
         false <- File.exists?(source) do
      :ok
    else
      _ -> {:error, Folder.io_error("delete #{source}, which was copied", :eacces)}
    end
  end

  def run_step(:finish, plan, opts) do
    pairs =
      for name <- Enum.uniq([plan.name | plan.entries]),
          do: {Path.join(plan.from, name), Path.join(plan.to, name)}

    if opts[:finish], do: opts[:finish].(pairs), else: :ok
  end

  def run_step({:forget, root}, plan, _opts), do: MovePlan.delete_note(plan, root)

  # Another program may have deleted the copy, because its program was killed.
  defp copy_again(source, staged) do
    with {:error, reason} <- copy_entry(source, staged),
         do: {:error, Folder.io_error("copy #{source} to #{Path.dirname(staged)}", reason)}
  end

  defp rename_new(from, to) do
    case Native.rename_new(from, to) do
      :ok -> sync_names(from, to)
      :exists -> {:error, Folder.io_error("rename #{from} to #{to}", :eexist)}
      :unsupported -> rename_plain(from, to)
      {:error, reason} -> {:error, NativeErrors.to_error(reason, from)}
    end
  end

  defp rename_plain(from, to) do
    case AtomicFile.rename_synced(from, to) do
      :ok -> :ok
      {:error, reason} -> {:error, Folder.io_error("rename #{from} to #{to}", reason)}
    end
  end

  # The new name is on disk before the loss of the old one.
  defp sync_names(from, to) do
    AtomicFile.sync_folder(Path.dirname(to))
    AtomicFile.sync_folder(Path.dirname(from))
  end
end

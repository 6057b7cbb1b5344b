defmodule Situ.Store.Maintenance do
  @moduledoc false
  # Verifies, repairs, deletes and renames stores. Called through `Situ.Store`.
  alias Situ.Error
  alias Situ.Recording

  alias Situ.Store.{
    Deletion,
    Draft,
    Folder,
    Native,
    NativeErrors,
    NativeFormat,
    Query,
    Replacement,
    S3,
    SegmentedRecording,
    SegmentRenaming,
    Segments
  }

  @progress [type: {:fun, 2}, doc: "Called repeatedly as `fun.(done, total)`."]
  @verify_options [progress: @progress]
  @repair_options [
    dry_run: [type: :boolean, default: false, doc: "Only report the changes without making them."],
    progress: @progress
  ]

  @spec verify_options() :: Situ.Options.schema()
  def verify_options, do: @verify_options

  @spec repair_options() :: Situ.Options.schema()
  def repair_options, do: @repair_options

  @spec verify(Path.t(), keyword()) ::
          {:ok, %{chunks: non_neg_integer(), damage: [Situ.Store.damage()]}} | {:error, Error.t()}
  def verify(path, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @verify_options),
         {:ok, store} <- Query.open(path),
         do: verify_store(store, progress_fun(opts))
  end

  defp verify_store(%Recording{module: NativeFormat} = store, progress) do
    with {:ok, found, total} <- NativeFormat.verify_chunks(store.state, progress),
         do: {:ok, %{chunks: total, damage: describe_damage(Enum.uniq(found))}}
  end

  # Versions that cannot be opened may be segments, so they count as damage.
  defp verify_store(%Recording{module: SegmentedRecording, path: path}, progress) do
    path
    |> Segments.list_possible_folders()
    |> Enum.reject(&Segments.nothing_written?/1)
    |> Enum.map(&verify_segment(&1, progress))
    |> merge_reports(%{chunks: 0, damage: []})
  end

  defp verify_store(store, _progress),
    do: {:error, Error.new(:not_a_store, "#{store.path} is an external file, not a store")}

  defp verify_segment(folder, progress) do
    with {:ok, store} <- Query.open(folder), {:ok, report} <- verify_store(store, progress) do
      {:ok, prefix_damage(report, folder)}
    else
      {:error, error} ->
        {:ok, %{damage: [%{file: Path.basename(folder), offset: 0, why: error.what}]}}
    end
  end

  defp prefix_damage(%{damage: damage} = report, folder) do
    name = Path.basename(folder)
    %{report | damage: for(d <- damage, do: %{d | file: Path.join(name, d.file)})}
  end

  # Adds up the reports on the segments of a recording, or returns the first error.
  defp merge_reports(reports, start) do
    Enum.reduce_while(reports, {:ok, start}, fn
      {:ok, report}, {:ok, sum} -> {:cont, {:ok, Map.merge(sum, report, &merge_values/3)}}
      error, _sum -> {:halt, error}
    end)
  end

  defp merge_values(_key, one, other) when is_integer(one), do: one + other
  defp merge_values(_key, one, other) when is_list(one), do: one ++ other
  defp merge_values(_key, one, other), do: one or other

  defp progress_fun(opts), do: opts[:progress] || fn _, _ -> :ok end

  defp describe_damage(found),
    do: for({file, offset, why} <- found, do: %{file: file, offset: offset, why: why})

  @no_repairs %{
    kept: 0,
    dropped: 0,
    recovered: 0,
    unconfirmed: 0,
    rebuilt?: false,
    damage: []
  }

  @spec repair(Path.t(), keyword()) :: {:ok, map()} | {:error, Error.t()}
  def repair(path, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @repair_options),
         {:ok, path} <- complete_renaming(Path.expand(path), opts[:dry_run]),
         :ok <- restore_segments(path, opts[:dry_run]) do
      if Segments.segmented?(path),
        do: repair_segments(path, opts),
        else: repair_store(path, opts)
    end
  end

  defp complete_renaming(path, dry?) do
    case SegmentRenaming.find_interrupted(path) do
      nil -> {:ok, path}
      plan when dry? -> {:error, SegmentRenaming.interrupted_error(plan)}
      plan -> SegmentRenaming.complete(plan)
    end
  end

  # A segment whose compaction was interrupted has lost its name.
  defp restore_segments(path, dry?) do
    lost = Replacement.list_interrupted(path)

    cond do
      lost == [] or Folder.store_folder?(path) or not Segments.segmented?(path) -> :ok
      dry? -> {:error, NativeErrors.to_error(:compaction_interrupted, hd(lost))}
      true -> Enum.find_value(lost, :ok, &find_error(Replacement.restore_name(&1)))
    end
  end

  defp find_error(:ok), do: nil
  defp find_error(error), do: error

  defp repair_segments(path, opts) do
    path
    |> Segments.list_possible_folders()
    |> Enum.reject(&Segments.nothing_written?/1)
    |> Stream.map(&repair_segment(&1, opts))
    |> merge_reports(@no_repairs)
  end

  defp repair_segment(folder, opts) do
    with {:ok, report} <- repair_store(folder, opts), do: {:ok, prefix_damage(report, folder)}
  end

  defp repair_store(path, opts) do
    with {:ok, folder} <- find_to_repair(path, opts[:dry_run]),
         {:ok, {kept, dropped, recovered, unconfirmed, rebuilt?, damage}} <-
           folder
           |> run_repair(opts[:dry_run], progress_fun(opts))
           |> NativeErrors.wrap_error(folder) do
      {:ok,
       %{
         kept: kept,
         dropped: dropped,
         recovered: recovered,
         unconfirmed: unconfirmed,
         rebuilt?: rebuilt?,
         damage: describe_damage(damage)
       }}
    end
  end

  # An interrupted compaction may have left the store under another name.
  defp find_to_repair(path, dry?) do
    case {Folder.resolve_store(path), Replacement.find_interrupted(path)} do
      {nil, nil} ->
        {:ok, path}

      {nil, folder} when dry? == true ->
        {:error, NativeErrors.to_error(:compaction_interrupted, folder)}

      {nil, folder} ->
        with(:ok <- Replacement.restore_name(folder), do: {:ok, folder})

      {folder, _} ->
        {:ok, folder}
    end
  end

  # Native code runs in a separate process and sends its progress.
  defp run_repair(folder, dry?, progress) do
    {parent, tag} = {self(), make_ref()}
    task = Task.async(fn -> Native.store_repair(folder, dry?, parent, tag) end)
    await_repair(task, tag, progress)
  end

  defp await_repair(%{ref: ref} = task, tag, progress) do
    receive do
      {:situ_store, ^tag, {done, total}} ->
        progress.(done, total)
        await_repair(task, tag, progress)

      {^ref, answer} ->
        Process.demonitor(ref, [:flush])
        answer

      {:DOWN, ^ref, :process, _, reason} ->
        exit(reason)
    end
  end

  @spec delete(Path.t()) :: :ok | {:error, Error.t()}
  def delete("s3://" <> _ = address), do: with({:ok, _} <- S3.delete(address), do: :ok)

  def delete(path) do
    path = Path.expand(path)

    Draft.delete_abandoned(path)

    with :ok <- check_renaming(path),
         {:ok, folders} <- list_idle_folders(path),
         {:ok, unmarked} <- list_idle_unmarked(path),
         do: Enum.find_value(unmarked ++ folders, :ok, &find_error(Deletion.delete_folder(&1)))
  end

  @spec rename(Path.t(), String.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def rename(path, name) do
    path = Path.expand(path)

    case SegmentRenaming.find_interrupted(path) do
      %{to: ^name} = plan ->
        SegmentRenaming.complete(plan)

      nil ->
        with {:ok, folders} <- list_idle_folders(path), do: rename_folders(folders, path, name)

      plan ->
        {:error, SegmentRenaming.interrupted_error(plan)}
    end
  end

  defp rename_folders(folders, path, name) do
    if Segments.segmented?(path),
      do: SegmentRenaming.rename_segments(path, name),
      else: Folder.place_version(hd(folders), name, Path.dirname(hd(folders)))
  end

  defp check_renaming(path) do
    case SegmentRenaming.find_interrupted(path) do
      nil -> :ok
      plan -> {:error, SegmentRenaming.interrupted_error(plan)}
    end
  end

  @doc "Returns the folders of a recording, or an error if a folder is being written."
  @spec list_idle_folders(Path.t()) :: {:ok, [Path.t()]} | {:error, Error.t()}
  def list_idle_folders(path) do
    if Segments.segmented?(path) do
      folders = Segments.list_folders(path)
      with nil <- Enum.find_value(folders, &find_error(check_idle(&1))), do: {:ok, folders}
    else
      with {:ok, folder} <- resolve_folder(path), :ok <- check_idle(folder), do: {:ok, [folder]}
    end
  end

  # Otherwise the name would open an empty recording after its segments are deleted.
  defp list_idle_unmarked(path) do
    folders = if Segments.segmented?(path), do: Segments.list_unmarked(path), else: []
    with nil <- Enum.find_value(folders, &find_error(check_idle(&1))), do: {:ok, folders}
  end

  defp resolve_folder(path) do
    case Folder.resolve_store(Path.expand(path)) do
      nil -> {:error, NativeErrors.to_error(:no_store, path)}
      folder -> {:ok, folder}
    end
  end

  defp check_idle(folder) do
    case Query.open(folder) do
      {:ok, store} ->
        if Query.live?(store), do: {:error, NativeErrors.to_error(:locked, folder)}, else: :ok

      # The store is damaged or not readable, which must not prevent its deletion.
      {:error, _} ->
        :ok
    end
  end
end

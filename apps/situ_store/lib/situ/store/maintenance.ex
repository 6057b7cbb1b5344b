defmodule Situ.Store.Maintenance do
  @moduledoc false
  # Verifies, repairs, deletes and renames stores. Called through `Situ.Store`.
  alias Situ.Error
  alias Situ.Recording
  alias Situ.Store.{NativeErrors, Folder, NativeFormat, Native, Query, Replacement}

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
         :ok <- check_own_format(store),
         {:ok, found, total} <- NativeFormat.verify_chunks(store.state, progress_fun(opts)),
         do: {:ok, %{chunks: total, damage: describe_damage(Enum.uniq(found))}}
  end

  defp progress_fun(opts), do: opts[:progress] || fn _, _ -> :ok end

  defp describe_damage(found),
    do: for({file, offset, why} <- found, do: %{file: file, offset: offset, why: why})

  defp check_own_format(%Recording{module: NativeFormat}), do: :ok

  defp check_own_format(store),
    do: {:error, Error.new(:not_a_store, "#{store.path} is an external file, not a store")}

  @spec repair(Path.t(), keyword()) :: {:ok, map()} | {:error, Error.t()}
  def repair(path, opts \\ []) do
    path = Path.expand(path)

    with {:ok, folder} <- find_to_repair(path, opts[:dry_run]),
         {:ok, opts} <- Situ.Options.validate(opts, @repair_options),
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
  def delete(path) do
    with {:ok, folder} <- resolve_folder(path),
         :ok <- check_idle(folder),
         do: Folder.remove_store(folder)
  end

  @spec rename(Path.t(), String.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def rename(path, name) do
    with {:ok, folder} <- resolve_folder(path),
         :ok <- check_idle(folder),
         do: Folder.place_version(folder, name, Path.dirname(folder))
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

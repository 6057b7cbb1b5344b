defmodule Situ.Store.Mending do
  @moduledoc """
  Checking, mending, deleting and renaming stores. Called through `Situ.Store`.
  """
  alias Situ.Error
  alias Situ.Store.{Failure, Folder, Handle, Local, Native, Reading, Replacement}

  @typedoc "A wrong place: the file, the byte, and what is wrong there."
  @type damage :: %{file: String.t(), offset: non_neg_integer(), why: String.t()}

  @progress [type: {:fun, 2}, doc: "`fun.(done, total)`, called as it goes."]
  @verify_options [progress: @progress]
  @repair_options [
    dry_run: [type: :boolean, default: false, doc: "Only tell what would be done."],
    progress: @progress
  ]

  @doc """
  Reads everything and checks every checksum: `{:ok, %{chunks, damage}}`.

  #{Situ.Options.docs(@verify_options)}
  """
  @spec verify(Path.t(), keyword()) ::
          {:ok, %{chunks: non_neg_integer(), damage: [damage()]}} | {:error, Error.t()}
  def verify(path, opts \\ []) do
    with {:ok, opts} <- Situ.Options.validate(opts, @verify_options),
         {:ok, store} <- Reading.open(path),
         :ok <- ours(store),
         {:ok, found, total} <- Local.verify(store.state, progress(opts)),
         do: {:ok, %{chunks: total, damage: places(Enum.uniq(found))}}
  end

  defp progress(opts), do: opts[:progress] || fn _, _ -> :ok end

  defp places(found),
    do: for({file, offset, why} <- found, do: %{file: file, offset: offset, why: why})

  defp ours(%Handle{module: Local}), do: :ok

  defp ours(store),
    do: {:error, Error.new(:not_a_store, "#{store.path} is a foreign file, not a store")}

  @doc """
  Makes a store whole that was not closed or is damaged: `{:ok, report}` with `kept`, `dropped`, `recovered`,
  `unconfirmed`, `rebuilt?` and `damage`.

  A sound store that was merely not closed is cut to size and marked closed. Every chunk that could be read before is
  kept. Where the index is damaged or lost, its places are filled from the data with the chunks that are known to have
  been committed (`recovered`); chunks that are damaged themselves are left out (`dropped`). If the whole index is
  lost, nothing shows that the last commit of a killed writer was acknowledged, so it is left out (`unconfirmed`). The
  data files are not rewritten, but for the header of an extent when that is damaged; the old index stays as
  `index.situ.before-repair`, with a number where there is one already.

  #{Situ.Options.docs(@repair_options)}
  """
  @spec repair(Path.t(), keyword()) :: {:ok, map()} | {:error, Error.t()}
  def repair(path, opts \\ []) do
    path = Path.expand(path)

    with {:ok, folder} <- find_to_repair(path, opts[:dry_run]),
         {:ok, opts} <- Situ.Options.validate(opts, @repair_options),
         {:ok, {kept, dropped, recovered, unconfirmed, rebuilt?, damage}} <-
           folder |> mend(opts[:dry_run], progress(opts)) |> Failure.wrap(folder) do
      {:ok,
       %{
         kept: kept,
         dropped: dropped,
         recovered: recovered,
         unconfirmed: unconfirmed,
         rebuilt?: rebuilt?,
         damage: places(damage)
       }}
    end
  end

  # A killed compaction may have left the store under another name.
  defp find_to_repair(path, dry?) do
    case {Folder.resolve(path), Replacement.find_interrupted(path)} do
      {nil, nil} -> {:ok, path}
      {nil, folder} when dry? == true -> {:error, Failure.error(:compaction_interrupted, folder)}
      {nil, folder} -> with(:ok <- Replacement.restore(folder), do: {:ok, folder})
      {folder, _} -> {:ok, folder}
    end
  end

  # The native side works in a process of its own and sends how far it is.
  defp mend(folder, dry?, progress) do
    {parent, tag} = {self(), make_ref()}
    task = Task.async(fn -> Native.store_repair(folder, dry?, parent, tag) end)
    watch(task, tag, progress)
  end

  defp watch(%{ref: ref} = task, tag, progress) do
    receive do
      {:situ_store, ^tag, {done, total}} ->
        progress.(done, total)
        watch(task, tag, progress)

      {^ref, answer} ->
        Process.demonitor(ref, [:flush])
        answer

      {:DOWN, ^ref, :process, _, reason} ->
        exit(reason)
    end
  end

  @doc "Deletes a store's files, and its folder when nothing else is in it. Not while it is being written."
  @spec delete(Path.t()) :: :ok | {:error, Error.t()}
  def delete(path) do
    with {:ok, folder} <- resolve(path),
         :ok <- idle(folder),
         do: Folder.remove(folder)
  end

  @doc "Gives a store another name (its folder's, keeping the version number): `{:ok, new_path}`."
  @spec rename(Path.t(), String.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def rename(path, name) do
    with {:ok, folder} <- resolve(path),
         :ok <- idle(folder),
         do: Folder.place_version(folder, name, Path.dirname(folder))
  end

  defp resolve(path) do
    case Folder.resolve(Path.expand(path)) do
      nil -> {:error, Failure.error(:no_store, path)}
      folder -> {:ok, folder}
    end
  end

  defp idle(folder) do
    case Reading.open(folder) do
      {:ok, store} ->
        if Reading.live?(store), do: {:error, Failure.error(:locked, folder)}, else: :ok

      # Damaged or not ours to read: no reason to keep it.
      {:error, _} ->
        :ok
    end
  end
end

defmodule Situ.Store.Mending do
  @moduledoc """
  Checking, mending, deleting and renaming stores. Called through `Situ.Store`.
  """
  alias Situ.Error
  alias Situ.Store.{Failure, Folder, Handle, Local, Native, Reading}

  @typedoc "A wrong place: the file, the byte, and what is wrong there."
  @type damage :: %{file: String.t(), offset: non_neg_integer(), why: String.t()}

  @doc """
  Reads everything and checks every checksum: `{:ok, %{chunks, damage}}`.

  `progress: fun.(done, total)` is called as it goes.
  """
  @spec verify(Path.t(), keyword()) ::
          {:ok, %{chunks: non_neg_integer(), damage: [damage()]}} | {:error, Error.t()}
  def verify(path, opts \\ []) do
    with {:ok, store} <- Reading.open(path),
         :ok <- ours(store),
         {:ok, found, total} <- Local.verify(store.state, opts[:progress] || fn _, _ -> :ok end) do
      damage =
        for {file, offset, why} <- Enum.uniq(found), do: %{file: file, offset: offset, why: why}

      {:ok, %{chunks: total, damage: damage}}
    end
  end

  defp ours(%Handle{module: Local}), do: :ok

  defp ours(store),
    do: {:error, Error.new(:not_a_store, "#{store.path} is a foreign file, not a store")}

  @doc """
  Makes a store whole that was not closed or is damaged: `{:ok, %{kept, dropped, rebuilt?, damage}}`.

  A sound store that was merely not closed is cut to size and marked closed. Damaged chunks are dropped from the index (the data
  files are never rewritten; the old index stays as `index.situ.before-repair`); a lost index is rebuilt from the data.
  `progress: fun.(done, total)` is called as it goes.
  """
  @spec repair(Path.t(), keyword()) :: {:ok, map()} | {:error, Error.t()}
  def repair(path, opts \\ []) do
    path = Path.expand(path)
    folder = Folder.resolve(path) || path

    with {:ok, {kept, dropped, rebuilt?, damage}} <-
           folder
           |> mend(opts[:progress] || fn _, _ -> :ok end)
           |> Failure.wrap(folder) do
      damage = for {file, offset, why} <- damage, do: %{file: file, offset: offset, why: why}
      {:ok, %{kept: kept, dropped: dropped, rebuilt?: rebuilt?, damage: damage}}
    end
  end

  # The native side works in a process of its own and sends how far it is.
  defp mend(folder, progress) do
    {parent, tag} = {self(), make_ref()}
    task = Task.async(fn -> Native.store_repair(folder, parent, tag) end)
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
         root = Path.dirname(folder),
         {:ok, target} <- Folder.create(name, root, true),
         :ok <- File.rename(folder, target) do
      {:ok, target}
    else
      {:error, %Error{}} = error -> error
      {:error, reason} -> {:error, Error.new(:io, "cannot rename #{path}", why: inspect(reason))}
    end
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

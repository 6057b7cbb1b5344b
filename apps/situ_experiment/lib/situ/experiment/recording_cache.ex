defmodule Situ.Experiment.RecordingCache do
  @moduledoc false
  # The recordings of a session on a node of a cluster. A recording that is on the node under the same path, with the
  # same sizes and times of its files, is read there: the folder is shared, or it is the same machine. Any other one is
  # copied from the node that started the run into the user's cache folder, where later runs find it. A copy that was
  # not used for a week is deleted when a run begins.
  # See docs/adr/0184-nodes-of-a-cluster-compute-trials.md.
  alias Situ.Dataset.{Session, StoredPath}
  alias Situ.Error
  alias Situ.Experiment.{CodeVersion, FileTransfer}

  @kept_s 7 * 24 * 3600

  @typedoc "The files of each partition whose recording is a path, by the partition's name, and the stamps of all."
  @type inputs :: %{String.t() => {stamp :: String.t(), [FileTransfer.entry()]}}

  @doc "Returns the cache folder of experiments on this machine."
  @spec cache_folder() :: Path.t()
  def cache_folder, do: :filename.basedir(:user_cache, "situ/experiments")

  @doc "Describes the recordings of a session for `locate_session/3` on another node."
  @spec describe_inputs(Session.t(), %{String.t() => String.t()}) :: inputs()
  def describe_inputs(%Session{partitions: partitions}, stamps) do
    for %{name: name, path: path} <- partitions,
        not StoredPath.address?(path),
        into: %{},
        do: {name, {stamps[name], FileTransfer.list_recording(path)}}
  end

  @doc """
  Returns the session with the paths of its recordings on this node, after copying them from `owner` if necessary.
  Error: `:not_copied`.
  """
  @spec locate_session(Session.t(), inputs(), node()) :: {:ok, Session.t()} | {:error, Error.t()}
  def locate_session(%Session{partitions: partitions} = session, inputs, owner) do
    located =
      Error.map_ok(partitions, fn partition ->
        with {:ok, path} <- locate_recording(partition.path, inputs[partition.name], owner),
             do: {:ok, %{partition | path: path}}
      end)

    with {:ok, partitions} <- located, do: {:ok, %{session | partitions: partitions}}
  end

  # An address, or a recording that does not exist: its error is the same here.
  defp locate_recording(path, nil, _owner), do: {:ok, path}
  defp locate_recording(path, {_stamp, []}, _owner), do: {:ok, path}

  defp locate_recording(path, {stamp, entries}, owner) do
    if FileTransfer.list_recording(path) == entries,
      do: {:ok, path},
      else: find_copy(path, {stamp, entries}, owner)
  end

  defp find_copy(path, {stamp, entries}, owner) do
    contents = for {name, size, _} <- entries, do: {name, size}
    key = CodeVersion.hash_term({stamp, contents})
    folder = Path.join([cache_folder(), "recordings", String.slice(key, 0, 32)])
    lock = {{__MODULE__, folder}, self()}

    with :ok <-
           :global.trans(lock, fn -> ensure_copy(folder, path, entries, owner) end, [node()]),
         do: {:ok, Path.join(folder, Path.basename(path))}
  end

  defp ensure_copy(folder, path, entries, owner) do
    if File.dir?(folder), do: File.touch(folder), else: copy_files(folder, path, entries, owner)
  end

  # The folder gets its name when it is complete. Another machine may share the cache folder.
  defp copy_files(folder, path, entries, owner) do
    random = Base.encode16(:crypto.strong_rand_bytes(8), case: :lower)
    draft = "#{folder}.#{random}.unfinished"
    result = FileTransfer.fetch_files(owner, Path.dirname(path), entries, draft)
    renamed = if result == :ok, do: File.rename(draft, folder)
    _ = File.rm_rf(draft)

    cond do
      result != :ok -> result
      renamed == :ok or File.dir?(folder) -> :ok
      true -> {:error, rename_error(draft, renamed)}
    end
  end

  defp rename_error(draft, {:error, reason}) do
    Error.new(:not_copied, "cannot rename #{draft}",
      why: to_string(:file.format_error(reason)),
      fix: "check the folder #{cache_folder()}"
    )
  end

  @doc "Deletes copies that were not used for a week before `now`, in seconds since 1970."
  @spec delete_old_copies(integer()) :: :ok
  def delete_old_copies(now) do
    for path <- cache_folder() |> Path.join("recordings/*") |> Path.wildcard(),
        {:ok, %{mtime: used}} <- [File.stat(path, time: :posix)],
        now - used > @kept_s,
        do: File.rm_rf(path)

    :ok
  end
end

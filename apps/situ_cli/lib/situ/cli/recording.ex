defmodule Situ.CLI.Recording do
  @moduledoc false
  # Handles recordings as arguments: patterns, several paths, and starting the applications that read external formats
  # when one is used.
  alias Situ.Store
  alias Situ.Recording.Formats

  @format_apps [:situ_store, :situ_media, :situ_bridge, :situ_dataset, :situ_link, :situ_space]

  @doc "Opens a recording or raises an error."
  @spec open!(Path.t()) :: Store.t()
  def open!(path) do
    load_formats([path])
    Store.open!(path)
  end

  @doc "Loads the applications of all file formats, and starts them if a path is a file or an address."
  @spec load_formats([Path.t()]) :: :ok
  def load_formats(paths) do
    for app <- @format_apps, do: Application.load(app)

    if Enum.any?(paths, &(File.regular?(&1) or Formats.for_address(&1) != nil)),
      do: for(app <- @format_apps, do: {:ok, _} = Application.ensure_all_started(app))

    :ok
  end

  @doc "Expands patterns that the shell did not expand (because of quotes); patterns without matches are kept."
  @spec expand_patterns([Path.t()]) :: [Path.t()]
  def expand_patterns(paths) do
    Enum.flat_map(paths, fn path ->
      if path =~ ~r/[*?\[{]/ and not File.exists?(path) and not String.contains?(path, "://"),
        do: path |> Path.wildcard() |> Enum.sort() |> then(&if(&1 == [], do: [path], else: &1)),
        else: [path]
    end)
  end

  @doc "Returns the size of a recording on disk in bytes."
  @spec disk_size(Store.t()) :: non_neg_integer()
  def disk_size(store) do
    case Store.segments(store) do
      [] -> store |> files_path() |> path_size()
      segments -> segments |> Enum.map(&path_size(&1.path)) |> Enum.sum()
    end
  end

  # The files of a recording in object storage are in a cache.
  defp files_path(%{state: %Store.NativeFormat{path: path}}), do: path
  defp files_path(store), do: store.path

  @doc """
  Returns the size of a file, or of the files in a folder, in bytes. For a folder of the cache of object storage, it is
  the size of the remote recording.
  """
  @spec path_size(Path.t()) :: non_neg_integer()
  def path_size(path), do: Store.S3.remote_bytes(path) || local_size(path)

  defp local_size(path) do
    # Path.wildcard/1 fails on names that are not UTF-8.
    files =
      case File.ls(path) do
        {:ok, names} -> Enum.map(names, &Path.join(path, &1))
        {:error, _} -> [path]
      end

    files
    |> Enum.map(fn file ->
      case File.stat(file) do
        {:ok, %{type: :regular, size: size}} -> size
        _ -> 0
      end
    end)
    |> Enum.sum()
  end
end

defmodule Situ.Link.Server.RecordingVersions do
  @moduledoc false
  # Treats the versions of a recording in one folder (`name.0000` and later) as one sequence.
  alias Situ.Store.{Folder, Query, StreamInfo}

  @type found :: {non_neg_integer(), Situ.Recording.t(), StreamInfo.t()}

  @spec newest_version(Path.t(), String.t()) :: {non_neg_integer(), Path.t()} | nil
  def newest_version(root, name) do
    with path when path != nil <- Folder.newest_version(name, root),
         do: {Folder.version_number(path), path}
  end

  @doc "Returns the path of a version, or `nil` if it does not exist."
  @spec version_path(Path.t(), String.t(), non_neg_integer()) :: Path.t() | nil
  def version_path(root, name, version),
    do: Enum.find_value(version_paths(root, name), fn {v, path} -> v == version && path end)

  @doc "Finds the newest version whose `stream` begins at or before `time`, or else the oldest that has the stream."
  @spec find_containing(Path.t(), String.t(), String.t(), Situ.Time.t()) :: found() | nil
  def find_containing(root, name, stream, time) do
    root
    |> versions_with_stream(name, stream, :desc)
    |> Enum.reduce_while(nil, fn {_, _, info} = found, _oldest ->
      if info.first != nil and info.first <= time, do: {:halt, found}, else: {:cont, found}
    end)
  end

  @doc "Finds the newest version in which `stream` has messages."
  @spec with_messages(Path.t(), String.t(), String.t()) :: found() | nil
  def with_messages(root, name, stream),
    do:
      root
      |> versions_with_stream(name, stream, :desc)
      |> Enum.find(fn {_, _, info} -> info.count > 0 end)

  @doc """
  Finds the version that continues a stream after its cursor has read all of the current version. A version still being
  written, such as a segment of a recording, is left only when the stream has begun in a later one.
  """
  @spec find_next(Path.t(), String.t(), map()) :: found() | nil
  def find_next(root, name, %{version: version, store: store, info: %{name: stream}}) do
    later =
      root
      |> versions_with_stream(name, stream, :asc)
      |> Stream.filter(fn {v, _, _} -> v > version end)

    case Enum.find(later, fn {_, _, info} -> info.count > 0 end) do
      nil -> if Query.live?(store), do: nil, else: later |> Enum.to_list() |> List.last()
      found -> found
    end
  end

  defp versions_with_stream(root, name, stream, order) do
    root
    |> version_paths(name)
    |> Enum.sort(order)
    |> Stream.flat_map(fn {version, path} ->
      with {:ok, store} <- Query.open(path),
           {:ok, info} <- Query.stream_info(store, stream) do
        [{version, store, info}]
      else
        # The version was deleted or has not been created yet.
        {:error, _} -> []
      end
    end)
  end

  defp version_paths(root, name) do
    case File.ls(root) do
      {:ok, entries} ->
        for entry <- entries,
            path = Path.join(root, entry),
            version = Folder.version_number(path),
            Folder.store_name(path) == name,
            do: {version, path}

      {:error, _} ->
        []
    end
  end
end

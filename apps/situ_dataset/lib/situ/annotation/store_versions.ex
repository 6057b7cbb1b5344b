defmodule Situ.Annotation.StoreVersions do
  @moduledoc false
  # Reads and writes the versions of a store of annotations. The metadata of a stream names the log and the operation up
  # to which the version contains it (`mark`). A version without a mark of the log was written by another program.
  alias Situ.Annotation.{Layer, Recording}
  alias Situ.Dataset.StoreVersion
  alias Situ.{Error, Store}

  # The number of attempts to write a version while other programs save at the same time.
  @tries 100

  @typedoc "The log and the position that a version contains, as stored in its metadata."
  @type mark :: %{String.t() => term()}

  @doc "Returns the folders of the versions of a store, newest first."
  @spec list_folders(Path.t()) :: [Path.t()]
  def list_folders(path) do
    versions =
      for folder <- Store.list(Path.dirname(path)), Path.rootname(folder) == path, do: folder

    cond do
      versions != [] -> Enum.sort_by(versions, &{byte_size(&1), &1}, :desc)
      Store.exists?(path) -> [path]
      true -> []
    end
  end

  @doc "Returns the error for a layer that was open and does not exist any more."
  @spec moved_error(Path.t()) :: Error.t()
  def moved_error(document) do
    Error.new(:layer_moved, "the annotations in #{document} do not exist any more",
      why: "another program has moved or deleted them",
      fix: "open the recording in its new folder"
    )
  end

  @doc "Returns the newest version of a store, or `nil`."
  @spec newest_folder(Path.t()) :: Path.t() | nil
  def newest_folder(path),
    do: StoreVersion.newest_folder(path) || if(Store.exists?(path), do: path)

  @doc "Returns the mark of a stream in a version; `:none` if the version does not have the stream."
  @spec read_mark(Path.t(), String.t()) :: {:ok, mark() | nil} | :none | {:error, Error.t()}
  def read_mark(folder, stream) do
    with {:ok, store} <- Store.open(folder) do
      case Store.stream_info(store, stream) do
        {:ok, info} -> {:ok, Recording.read_mark(store, info)}
        {:error, _} -> :none
      end
    end
  end

  @doc "Returns the annotations of a stream in a version."
  @spec load_layer(Path.t(), String.t()) :: {:ok, Layer.t()} | {:error, Error.t()}
  def load_layer(folder, stream) do
    with {:ok, store} <- Store.open(folder), do: Recording.load_layer(store, stream)
  end

  @doc """
  Writes the layer as a stream of the next version, and returns its folder. The other streams are copied from the newest
  version, no matter which program saved it.
  """
  @spec write_version(Path.t(), String.t(), {Layer.t(), mark()}) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def write_version(path, stream, marked), do: write_version(path, stream, marked, @tries)

  defp write_version(path, stream, marked, tries) do
    newest = newest_folder(path)

    with {:ok, others} <- load_others(newest, stream),
         {:error, %Error{code: :newer_version}} when tries > 0 <-
           Recording.write_after(Map.put(others, stream, marked), path, newest),
         do: write_version(path, stream, marked, tries - 1)
  end

  defp load_others(nil, _stream), do: {:ok, %{}}

  defp load_others(folder, stream) do
    with {:ok, store} <- Store.open(folder) do
      infos = for info <- Store.streams(store), info.name != stream, do: info

      with {:ok, layers} <- Error.map_ok(infos, &load_marked(store, &1)),
           do: {:ok, Map.new(layers)}
    end
  end

  defp load_marked(store, info) do
    with {:ok, layer} <- Recording.load_layer(store, info),
         do: {:ok, {info.name, {layer, Recording.read_mark(store, info)}}}
  end
end

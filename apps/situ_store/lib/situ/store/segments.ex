defmodule Situ.Store.Segments do
  @moduledoc false
  # Finds the segments of a segmented recording: the versions of a name that are marked as segments in their catalogs.
  # Other versions of the name are recordings of their own.
  # See docs/adr/0168-segments-of-a-name-are-one-recording.md.
  alias Situ.Recording
  alias Situ.Store.{Folder, NativeFormat, SegmentedRecording}

  @doc "Returns whether the store in a folder is a segment, or the error if it cannot be opened."
  @spec check_segment(Path.t()) :: boolean() | {:error, Situ.Error.t()}
  def check_segment(folder) do
    with {:ok, state} <- NativeFormat.open(folder, []), do: NativeFormat.info(state).piece != nil
  rescue
    error in Situ.Error -> {:error, error}
  end

  @doc "Returns whether `path` is the name of a segmented recording: whether its newest readable version is a segment."
  @spec segmented?(Path.t()) :: boolean()
  def segmented?(path) do
    not Folder.store_folder?(path) and
      path
      |> Path.basename()
      |> Folder.list_versions(Path.dirname(path))
      |> Enum.reverse()
      |> Stream.map(&check_segment/1)
      # A version that a crash left without an index says nothing about the others.
      |> Enum.find(false, &is_boolean/1)
  end

  @doc "Returns the folders of a recording's segments, oldest first, or its own path if it has no segments."
  @spec list_folders(Recording.t()) :: [Path.t()]
  def list_folders(%Recording{module: SegmentedRecording} = store),
    do: for(segment <- SegmentedRecording.list_segments(store), do: segment.path)

  def list_folders(%Recording{path: path}), do: [path]
end

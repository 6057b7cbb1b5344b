defmodule Situ.Studio.Annotating.Shelf do
  @moduledoc """
  Where the annotations of a recording lie: each stream in a store of its own beside it, so that two people who annotate
  it at the same time save independently of each other.

      iex> Situ.Studio.Annotating.Shelf.store("/study/lobby.0000", "Speech.Ada")
      "/study/lobby.0000-annotation-Speech%2EAda"
  """
  alias Situ.Annotation.Recording
  alias Situ.Store

  @doc "The store of one stream of annotations, without its version."
  @spec store(Path.t(), String.t()) :: Path.t()
  def store(recording, stream), do: prefix(recording) <> safe(stream)

  defp prefix(recording), do: recording <> "-annotation-"

  # A dot would end in what looks like a version.
  defp safe(stream),
    do: stream |> URI.encode(&URI.char_unreserved?/1) |> String.replace(".", "%2E")

  @doc "The streams of annotations that there are of a recording."
  @spec streams(Path.t()) :: [String.t()]
  def streams(recording) do
    start = Path.basename(prefix(recording))
    folder = Path.dirname(recording)

    with {:ok, names} <- File.ls(folder) do
      for(
        name <- names,
        String.starts_with?(name, start),
        path = Path.join(folder, Path.rootname(name)),
        uniq: true,
        do: path
      )
      |> Enum.flat_map(&held/1)
      |> Enum.sort()
    else
      _ -> []
    end
  end

  defp held(path) do
    with true <- Store.exists?(path), {:ok, store} <- Store.open(path) do
      for info <- Store.streams(store), Recording.annotations?(store, info), do: info.name
    else
      _ -> []
    end
  end
end

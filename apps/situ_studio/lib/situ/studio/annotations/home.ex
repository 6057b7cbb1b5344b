defmodule Situ.Studio.Annotations.Home do
  @moduledoc false
  # The place of an item's annotation layers: the store of a session's layers
  # (`Situ.Dataset.SessionLayers`), or the recording that has its layers next to it
  # (`Situ.Studio.Annotations.Files`). A session with one recording includes the layers next to
  # this recording, where earlier versions of the studio have stored them.
  alias Situ.Annotation.Recording
  alias Situ.{Dataset, Store}
  alias Situ.Dataset.{SessionLayers, StoreVersion}
  alias Situ.Studio.Annotations.Files

  @type t ::
          {:session, store :: Path.t(), recording :: Path.t() | nil} | {:recording, Path.t()}

  @doc "Returns the home of a recording's layers; `nil` for recordings that are layers themselves."
  @spec recording_home(Path.t()) :: t() | nil
  def recording_home(path),
    do: if(Files.layer_store?(path), do: nil, else: {:recording, path})

  @doc """
  Returns the home of a session's layers; `nil` if its dataset cannot be changed. `recording` is the session's only
  recording.
  """
  @spec session_home(Dataset.t(), String.t(), Path.t() | nil) :: t() | nil
  def session_home(dataset, session, recording \\ nil) do
    case SessionLayers.store_path(dataset, session) do
      {:ok, store} -> {:session, store, recording}
      {:error, _} -> nil
    end
  end

  @doc "Returns the newest versions of the stores of a home: `[{store, folder}]`."
  @spec list_versions(t()) :: [{Path.t(), Path.t()}]
  def list_versions({:session, store, nil}), do: newest_versions([store])

  def list_versions({:session, store, recording}),
    do: newest_versions([store | Files.list_stores(recording)])

  def list_versions({:recording, path}), do: path |> Files.list_stores() |> newest_versions()

  defp newest_versions(stores) do
    for store <- stores, folder = StoreVersion.newest_folder(store), do: {store, folder}
  end

  @doc "Returns the names of the layers of a home, sorted."
  @spec list_names(t()) :: [String.t()]
  def list_names(home) do
    names = for {_store, folder} <- list_versions(home), name <- list_streams(folder), do: name
    names |> Enum.uniq() |> Enum.sort()
  end

  @doc "Returns the store of an existing or new layer."
  @spec find_store(t(), String.t()) :: Path.t()
  def find_store(home, name) do
    Enum.find_value(list_versions(home), new_store(home, name), fn {store, folder} ->
      if name in list_streams(folder), do: store
    end)
  end

  defp new_store({:session, store, _recording}, _name), do: store
  defp new_store({:recording, path}, name), do: Files.store_path(path, name)

  defp list_streams(folder) do
    with {:ok, store} <- Store.open(folder) do
      for info <- Store.streams(store), Recording.annotation_stream?(store, info), do: info.name
    else
      _ -> []
    end
  end
end

defmodule Situ.Studio.Annotations.Home do
  @moduledoc false
  # The place of an item's annotation layers: the store of a session's layers
  # (`Situ.Dataset.SessionLayers`), or the recording that has its layers next to it
  # (`Situ.Studio.Annotations.Files`).
  alias Situ.Annotation.Recording
  alias Situ.{Dataset, Store}
  alias Situ.Dataset.{SessionLayers, StoreVersion}
  alias Situ.Studio.Annotations.Files

  @type t :: {:session, Path.t()} | {:recording, Path.t()}

  @doc "Returns the home of a recording's layers; `nil` for recordings that are layers themselves."
  @spec recording_home(Path.t()) :: t() | nil
  def recording_home(path),
    do: if(Files.layer_store?(path), do: nil, else: {:recording, path})

  @doc "Returns the home of a session's layers; `nil` if its dataset cannot be changed."
  @spec session_home(Dataset.t(), String.t()) :: t() | nil
  def session_home(dataset, session) do
    case SessionLayers.store_path(dataset, session) do
      {:ok, store} -> {:session, store}
      {:error, _} -> nil
    end
  end

  @doc "Returns the newest versions of the stores of a home: `[{store, folder}]`."
  @spec list_versions(t()) :: [{Path.t(), Path.t()}]
  def list_versions({:session, store}), do: newest_versions([store])
  def list_versions({:recording, path}), do: path |> Files.list_stores() |> newest_versions()

  defp newest_versions(stores) do
    for store <- stores, folder = StoreVersion.newest_folder(store), do: {store, folder}
  end

  @doc "Returns the names of the layers of a home."
  @spec list_names(t()) :: [String.t()]
  def list_names(home) do
    for {_store, folder} <- list_versions(home), name <- list_streams(folder), do: name
  end

  defp list_streams(folder) do
    with {:ok, store} <- Store.open(folder) do
      for info <- Store.streams(store), Recording.annotation_stream?(store, info), do: info.name
    else
      _ -> []
    end
  end
end

defmodule Situ.Studio.Annotations.Layers do
  @moduledoc false
  # Finds, opens and copies the annotation layers of an item of the catalog. The layers of a
  # session are the streams of one store next to the dataset file (`Situ.Dataset.SessionLayers`).
  # The layers of any other recording are stores next to it (`Situ.Studio.Annotations.Files`).
  # Layers in recordings and other partitions can be copied, but not edited.
  alias Situ.Annotation.{Editor, Layer, Recording, Schema}
  alias Situ.{Dataset, Error}
  alias Situ.Dataset.{NameRules, OpenSession, Partition, Session, SessionLayers}
  alias Situ.Studio.Annotations.Home
  alias Situ.Studio.{Annotations, Catalog, Datasets, IntervalSearch}

  @doc "Returns the names of the layers of an item that can be edited, sorted."
  @spec list_names(Catalog.Item.t()) :: [String.t()]
  def list_names(%{layers: nil}), do: []

  def list_names(item), do: Home.list_names(item.layers)

  @doc """
  Returns the editor of a layer. `schema` creates a missing layer; the first layer of a session also adds the store to
  the dataset.
  """
  @spec open_editor(Catalog.id(), Catalog.Item.t(), String.t(), Schema.t() | nil) ::
          {:ok, pid()} | {:error, Error.t()}
  def open_editor(studio, item, name, schema) do
    store = Home.find_store(item.layers, name)

    with {:ok, editor} <- Annotations.open_editor(studio, store, name, schema),
         :ok <- link_store(studio, item, store) do
      {:ok, editor}
    end
  end

  defp link_store(studio, %{layers: {:session, store, _}} = item, store) do
    with {:ok, %{path: file}} <- Catalog.fetch_item(studio, item.dataset),
         {:ok, dataset} <- Dataset.load(file),
         {:ok, session} <- Dataset.session(dataset, item.session) do
      if Enum.any?(session.partitions, &SessionLayers.layers_partition?/1),
        do: :ok,
        else: add_partition(studio, file, item.session)
    end
  end

  defp link_store(_studio, _item, _store), do: :ok

  defp add_partition(studio, file, session) do
    with {:ok, server} <- Datasets.open_server(studio, file),
         {:ok, _} <- Datasets.edit(server, &SessionLayers.add_partition(&1, session)),
         do: :ok
  end

  @doc "Returns the current annotations of a layer of an item in another page or session."
  @spec read_layer(Catalog.id(), Catalog.Item.t(), String.t()) ::
          {:ok, Layer.t()} | {:error, Error.t()}
  def read_layer(studio, item, name) do
    with {:ok, editor} <-
           Annotations.open_editor(studio, Home.find_store(item.layers, name), name, nil),
         do: {:ok, Editor.current_layer(editor)}
  end

  @doc "Lists the layers that an item's recordings contain as `[{partition, stream}]`. Opens the recordings."
  @spec list_foreign(Catalog.Item.t()) :: [{String.t(), String.t()}]
  def list_foreign(item) do
    for %{partition: partition, stream: stream} <-
          item |> open_recordings() |> SessionLayers.list_layers(),
        do: {partition, stream}
  end

  defp open_recordings(item) do
    session =
      for {name, path} <- IntervalSearch.searchable_parts(item), reduce: Session.new("page") do
        session ->
          case Session.add_partition(session, Partition.new(name, path)) do
            {:ok, session} -> session
            {:error, _} -> session
          end
      end

    OpenSession.open(session)
  end

  @doc "Stores a new layer under a free name of an item, and returns the name."
  @spec create_layer(map(), String.t(), Layer.t()) :: {:ok, String.t()} | {:error, Error.t()}
  def create_layer(%{studio: studio, item: item}, base, layer) do
    name = NameRules.make_unique(base, list_names(item))
    store = Home.find_store(item.layers, name)

    with :ok <- SessionLayers.write_layer(store, name, layer),
         :ok <- link_store(studio, item, store),
         do: {:ok, name}
  end

  @doc "Copies a layer of an item's recordings into a layer that can be edited, and returns the new layer's name."
  @spec copy_foreign(Catalog.id(), Catalog.Item.t(), {String.t(), String.t()}) ::
          {:ok, String.t()} | {:error, Error.t()}
  def copy_foreign(studio, item, {partition, stream}) do
    address = "[#{partition}]:#{stream}"

    with {:ok, {_, recording, _}} <-
           item |> open_recordings() |> OpenSession.fetch_stream(address),
         {:ok, layer} <- Recording.load_layer(recording, stream),
         do: create_layer(%{studio: studio, item: item}, stream, layer)
  end
end

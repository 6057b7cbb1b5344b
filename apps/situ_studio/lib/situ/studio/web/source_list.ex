defmodule Situ.Studio.Web.SourceList do
  @moduledoc false
  # Lists the other sources that the page of a recording links to.
  alias Situ.Studio.Catalog
  alias Situ.Studio.Datasets.DatasetRef
  alias Situ.Studio.Web.Paths

  @spec list_sources(map()) :: [
          %{id: String.t(), title: String.t(), kind: atom(), href: String.t()}
        ]
  # For a recording of a dataset, the list contains the dataset's sessions; otherwise, it contains all items.
  def list_sources(%{studio: studio, item: %{dataset: id}} = assigns) when is_binary(id) do
    with {:ok, %{path: file}} <- Catalog.fetch_item(studio, id),
         {:ok, dataset} <- Situ.Dataset.load(file) do
      back = %{id: id, title: dataset.name, kind: :dataset, href: Paths.dataset_path(id)}

      [
        back
        | for(s <- dataset.sessions, do: session_entry(DatasetRef.build_id(id, [s.name]), s.name))
      ]
    else
      _ -> assigns[:sources] || []
    end
  end

  def list_sources(%{studio: studio}), do: Enum.map(Catalog.list(studio), &item_entry/1)

  defp session_entry(id, name),
    do: %{id: id, title: name, kind: :session, href: Paths.source_path(id)}

  defp item_entry(item),
    do: %{id: item.id, title: item.title, kind: item.kind, href: Paths.item_path(item)}
end

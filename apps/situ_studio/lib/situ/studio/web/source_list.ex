defmodule Situ.Studio.Web.SourceList do
  @moduledoc false
  # The list of other sources that the page of a recording links to.
  alias Situ.Studio.Catalog
  alias Situ.Studio.Datasets.Place
  alias Situ.Studio.Web.Address

  @spec of(map()) :: [%{id: String.t(), title: String.t(), kind: atom(), href: String.t()}]
  # For a recording of a dataset, the list contains the dataset's sessions; otherwise, it contains all items.
  def of(%{studio: studio, item: %{dataset: id}} = assigns) when is_binary(id) do
    with {:ok, %{path: file}} <- Catalog.find(studio, id),
         {:ok, dataset} <- Situ.Dataset.load(file) do
      back = %{id: id, title: dataset.name, kind: :dataset, href: Address.dataset(id)}

      [back | for(s <- dataset.sessions, do: session(Place.id(id, [s.name]), s.name))]
    else
      _ -> assigns[:sources] || []
    end
  end

  def of(%{studio: studio}), do: Enum.map(Catalog.list(studio), &entry/1)

  defp session(id, name), do: %{id: id, title: name, kind: :session, href: Address.of(id)}

  defp entry(item),
    do: %{id: item.id, title: item.title, kind: item.kind, href: Address.item(item)}
end

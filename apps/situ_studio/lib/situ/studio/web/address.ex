defmodule Situ.Studio.Web.Address do
  @moduledoc false
  # Links are relative to the page's `<base>` element, because a proxy may put a path before the studio's own.

  @doc "Returns the path of the page that shows a recording, a stream source or a pipeline."
  @spec of(String.t()) :: String.t()
  def of(id), do: "s/" <> encode(id)

  @doc "Returns the path of a dataset's page."
  @spec dataset(String.t()) :: String.t()
  def dataset(id), do: "d/" <> encode(id)

  @doc "Returns the path of an item's page, whatever the item's kind."
  @spec item(%{:id => String.t(), :kind => atom(), optional(atom()) => term()}) :: String.t()
  def item(%{id: id, kind: :dataset}), do: dataset(id)
  def item(%{id: id}), do: of(id)

  @doc "Returns the path of an item's thumbnail."
  @spec thumbnail(String.t()) :: String.t()
  def thumbnail(id), do: "data/thumbnail?" <> URI.encode_query(%{"source" => id})

  @doc "Returns the path of the page that shows a pipeline's graph."
  @spec pipeline(String.t()) :: String.t()
  def pipeline(id), do: "p/" <> encode(id)

  defp encode(id) do
    id
    |> String.split("/")
    |> Enum.map_join("/", &URI.encode(&1, fn c -> URI.char_unreserved?(c) end))
  end
end

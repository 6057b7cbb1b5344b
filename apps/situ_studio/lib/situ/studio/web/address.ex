defmodule Situ.Studio.Web.Address do
  @moduledoc false
  # Links are relative to the base of the page (`Chrome.base/1`): behind a proxy there may be a path before them.

  @doc "The path of the page that shows an item."
  @spec of(String.t()) :: String.t()
  def of(id), do: "s/" <> encode(id)

  @doc "The path of the page of a dataset."
  @spec dataset(String.t()) :: String.t()
  def dataset(id), do: "d/" <> encode(id)

  @doc "The path of the page of whatever it is."
  @spec item(%{:id => String.t(), :kind => atom(), optional(atom()) => term()}) :: String.t()
  def item(%{id: id, kind: :dataset}), do: dataset(id)
  def item(%{id: id}), do: of(id)

  @doc "The path of its small picture."
  @spec thumbnail(String.t()) :: String.t()
  def thumbnail(id), do: "data/thumbnail?" <> URI.encode_query(%{"source" => id})

  @doc "The path of the page that shows its pipeline's graph."
  @spec pipeline(String.t()) :: String.t()
  def pipeline(id), do: "p/" <> encode(id)

  defp encode(id) do
    id
    |> String.split("/")
    |> Enum.map_join("/", &URI.encode(&1, fn c -> URI.char_unreserved?(c) end))
  end
end

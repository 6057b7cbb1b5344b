defmodule Situ.Studio.Web.Paths do
  @moduledoc false
  # Links are relative to the page's `<base>` element, because a proxy may put a path before the studio's own.

  @doc "Returns the path of the page that shows a recording, a stream source or a pipeline."
  @spec source_path(String.t()) :: String.t()
  def source_path(id), do: "s/" <> encode_id(id)

  @doc "Returns the path of a dataset's page."
  @spec dataset_path(String.t()) :: String.t()
  def dataset_path(id), do: "d/" <> encode_id(id)

  @doc "Returns the path of the page of the experiments over a dataset."
  @spec experiments_path(String.t()) :: String.t()
  def experiments_path(id), do: "x/" <> encode_id(id)

  @doc "Returns the path of the report on a run, as a page or in Markdown."
  @spec report_path(String.t(), String.t(), :html | :markdown) :: String.t()
  def report_path(id, run, format) do
    "experiments/report?" <>
      URI.encode_query(%{"dataset" => id, "run" => run, "format" => format})
  end

  @doc "Returns the path of an item's page, whatever the item's kind."
  @spec item_path(%{:id => String.t(), :kind => atom(), optional(atom()) => term()}) :: String.t()
  def item_path(%{id: id, kind: :dataset}), do: dataset_path(id)
  def item_path(%{id: id}), do: source_path(id)

  @doc "Returns the path of an item's thumbnail."
  @spec thumbnail_path(String.t()) :: String.t()
  def thumbnail_path(id), do: "data/thumbnail?" <> URI.encode_query(%{"source" => id})

  @doc "Returns the path of the page that shows a pipeline's graph."
  @spec pipeline_path(String.t()) :: String.t()
  def pipeline_path(id), do: "p/" <> encode_id(id)

  defp encode_id(id) do
    id
    |> String.split("/")
    |> Enum.map_join("/", &URI.encode(&1, fn c -> URI.char_unreserved?(c) end))
  end
end

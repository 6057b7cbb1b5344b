defmodule Situ.Studio.Datasets.DatasetRef do
  @moduledoc false
  # Identifies a session or a recording of a dataset in an address. The id consists of the
  # dataset's own id, the session and the partition, each escaped so that it contains no slash.

  @doc """
  Builds the id of a part of the dataset `dataset`.

      iex> id = Situ.Studio.Datasets.DatasetRef.build_id("study.json", ["day 1/am", "Room"])
      iex> id
      "study.json/day 1%2Fam/Room"
      iex> Situ.Studio.Datasets.DatasetRef.split_id(id)
      [{"study.json", ["day 1/am", "Room"]}, {"study.json/day 1%2Fam", ["Room"]}]
  """
  @spec build_id(String.t(), [String.t()]) :: String.t()
  def build_id(dataset, parts),
    do: Enum.join([dataset | Enum.map(parts, &escape/1)], "/")

  defp escape(name), do: URI.encode(name, &(&1 not in [?/, ?%]))

  @doc "Lists the ways to split an id into a dataset and one or two names, the deepest first."
  @spec split_id(String.t()) :: [{String.t(), [String.t()]}]
  def split_id(id) do
    segments = String.split(id, "/")

    for n <- [2, 1], length(segments) > n do
      {dataset, parts} = Enum.split(segments, -n)
      {Enum.join(dataset, "/"), Enum.map(parts, &unescape/1)}
    end
  end

  # Text with an invalid escape is taken literally.
  defp unescape(text) do
    URI.decode(text)
  rescue
    ArgumentError -> text
  end
end

defmodule Situ.Studio.Web.Address do
  @moduledoc false

  @doc "The path of the page that shows an item."
  @spec of(String.t()) :: String.t()
  def of(id), do: "/s/" <> encode(id)

  @doc "The path of the page that shows its pipeline's graph."
  @spec pipeline(String.t()) :: String.t()
  def pipeline(id), do: "/p/" <> encode(id)

  defp encode(id) do
    id
    |> String.split("/")
    |> Enum.map_join("/", &URI.encode(&1, fn c -> URI.char_unreserved?(c) end))
  end
end

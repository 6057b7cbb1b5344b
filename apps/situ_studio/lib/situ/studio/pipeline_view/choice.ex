defmodule Situ.Studio.PipelineView.Choice do
  @moduledoc false
  # Reads and writes the address of a pipeline's graph page, which contains the view: `heat`, `mark`, `way`, `fold`,
  # `sel`, `plots`, `at`. Pure. An address is untrusted, so unknown parts are ignored.
  alias Situ.Studio.PipelineView.{Marking, Stats}
  alias Situ.Studio.Web.Address

  @doc "Parses the choices in an address into assigns. `scopes` are the pipeline's composites."
  @spec read(map(), [String.t()]) :: keyword()
  def read(params, scopes) do
    heat(params["heat"]) ++
      one_of(:mark, params["mark"], Marking.choices()) ++
      one_of(:way, params["way"], Marking.directions()) ++
      folded(params["fold"], scopes) ++
      [selected: selected(params["sel"]), plots: plots(params["plots"])]
  end

  defp one_of(key, text, choices),
    do: if(List.keymember?(choices, text, 0), do: [{key, text}], else: [])

  defp heat("none"), do: [heat: "none"]

  defp heat(id) when is_binary(id),
    do: with({:ok, _} <- Stats.fetch(id), do: [heat: id], else: (_ -> []))

  defp heat(_), do: []

  defp folded(text, scopes) when is_binary(text) do
    named = text |> String.split("|", trim: true) |> MapSet.new()
    [folded: MapSet.intersection(named, MapSet.new(scopes))]
  end

  defp folded(_, _), do: []

  defp selected(key) when is_binary(key) and key != "", do: key
  defp selected(_), do: nil

  defp plots(text) when is_binary(text),
    do: for(id <- String.split(text, ","), {:ok, _} <- [Stats.fetch(id)], do: id)

  defp plots(_), do: []

  @doc "Encodes the folded composites for the address."
  @spec folds(Enumerable.t()) :: String.t()
  def folds(paths), do: paths |> Enum.sort() |> Enum.join("|")

  @doc "Folds or unfolds one composite, and encodes the result for the address."
  @spec toggle(MapSet.t(String.t()), String.t()) :: String.t()
  def toggle(folded, path) do
    folds(if path in folded, do: MapSet.delete(folded, path), else: MapSet.put(folded, path))
  end

  @doc "Builds the address of the view in `assigns` with some changes."
  @spec address(map(), map()) :: String.t()
  def address(assigns, changes) do
    now =
      %{
        "heat" => assigns.heat,
        "mark" => unless(assigns.mark == "none", do: assigns.mark),
        "way" => unless(assigns.way == "LR", do: assigns.way),
        "fold" => folds(assigns.folded),
        "sel" => assigns.selected,
        "plots" => Enum.join(assigns.plots, ","),
        "at" => if(assigns.live, do: nil, else: assigns.at)
      }
      |> Map.merge(changes)
      |> Map.reject(fn {key, value} -> value in [nil, ""] and key != "fold" end)

    "/" <> Address.pipeline(assigns.id) <> "?" <> URI.encode_query(now)
  end
end

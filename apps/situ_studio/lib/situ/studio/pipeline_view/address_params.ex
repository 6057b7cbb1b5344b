defmodule Situ.Studio.PipelineView.AddressParams do
  @moduledoc false
  # Reads and writes the address of a pipeline's graph page, which contains the view: `heat`, `mark`, `way`, `fold`,
  # `sel`, `plots`, `at`. Pure. An address is untrusted, so unknown parts are ignored.
  alias Situ.Studio.PipelineView.{Highlighting, Stats}
  alias Situ.Studio.Web.Paths

  @doc "Parses the choices in an address into assigns. `scopes` are the pipeline's composites."
  @spec parse_params(map(), [String.t()]) :: keyword()
  def parse_params(params, scopes) do
    parse_heat(params["heat"]) ++
      one_of(:mark, params["mark"], Highlighting.highlight_choices()) ++
      one_of(:way, params["way"], Highlighting.graph_directions()) ++
      parse_folded(params["fold"], scopes) ++
      [selected: parse_selected(params["sel"]), plots: parse_plots(params["plots"])]
  end

  defp one_of(key, text, choices),
    do: if(List.keymember?(choices, text, 0), do: [{key, text}], else: [])

  defp parse_heat("none"), do: [heat: "none"]

  defp parse_heat(id) when is_binary(id),
    do: with({:ok, _} <- Stats.fetch(id), do: [heat: id], else: (_ -> []))

  defp parse_heat(_), do: []

  defp parse_folded(text, scopes) when is_binary(text) do
    named = text |> String.split("|", trim: true) |> MapSet.new()
    [folded: MapSet.intersection(named, MapSet.new(scopes))]
  end

  defp parse_folded(_, _), do: []

  defp parse_selected(key) when is_binary(key) and key != "", do: key
  defp parse_selected(_), do: nil

  defp parse_plots(text) when is_binary(text),
    do: for(id <- String.split(text, ","), {:ok, _} <- [Stats.fetch(id)], do: id)

  defp parse_plots(_), do: []

  @doc "Encodes the folded composites for the address."
  @spec encode_folds(Enumerable.t()) :: String.t()
  def encode_folds(paths), do: paths |> Enum.sort() |> Enum.join("|")

  @doc "Folds or unfolds one composite, and encodes the result for the address."
  @spec toggle_fold(MapSet.t(String.t()), String.t()) :: String.t()
  def toggle_fold(folded, path) do
    encode_folds(
      if path in folded, do: MapSet.delete(folded, path), else: MapSet.put(folded, path)
    )
  end

  @doc "Builds the address of the view in `assigns` with some changes."
  @spec build_address(map(), map()) :: String.t()
  def build_address(assigns, changes) do
    now =
      %{
        "heat" => assigns.heat,
        "mark" => unless(assigns.mark == "none", do: assigns.mark),
        "way" => unless(assigns.way == "LR", do: assigns.way),
        "fold" => encode_folds(assigns.folded),
        "sel" => assigns.selected,
        "plots" => Enum.join(assigns.plots, ","),
        "at" => if(assigns.live, do: nil, else: assigns.at)
      }
      |> Map.merge(changes)
      |> Map.reject(fn {key, value} -> value in [nil, ""] and key != "fold" end)

    "/" <> Paths.pipeline_path(assigns.id) <> "?" <> URI.encode_query(now)
  end
end

defmodule Situ.Studio.PipelineView.Wire do
  @moduledoc false
  # Builds the messages to the page's hooks: the graph when its shape changes, statistics and colours at each tick, and
  # points of the plots.
  alias Situ.Studio.PipelineView.{FoldedGraph, Highlighting, Stats, Waits}

  @doc "Builds the message with the graph; `way` is its direction (`Highlighting.graph_directions/0`)."
  @spec graph_message(FoldedGraph.t(), String.t()) :: map()
  def graph_message(%FoldedGraph{} = graph, way \\ "LR") do
    %{
      way: way,
      nodes: Enum.map(graph.nodes, &Map.take(&1, [:key, :label, :kind, :parent, :path, :joins])),
      boxes: Enum.map(graph.boxes, &Map.take(&1, [:key, :label, :path, :parent])),
      edges:
        Enum.map(graph.edges, &Map.take(&1, [:key, :from, :to, :label, :policy, :lossy, :inline]))
    }
  end

  @doc "Builds the message with the heat of edges and nodes (0 to 1, relative to the largest), their texts and states."
  @spec stats_message(
          FoldedGraph.t(),
          Situ.Diagnostics.Snapshot.t(),
          Stats.sample(),
          {heat :: String.t(), mark :: String.t()},
          String.t() | nil
        ) ::
          map()
  def stats_message(graph, snapshot, sample, {heat, mark}, selected) do
    states = Map.new(snapshot.nodes, &{&1.id, &1})
    {edges, nodes} = heat_values(graph, sample, heat)

    waiting =
      if mark == "waits", do: for(w <- Waits.list_waits(snapshot, sample), do: w.edge), else: []

    %{
      selected: selected,
      edges:
        Map.new(graph.edges, fn edge ->
          faded? = Highlighting.faded?(mark, edge.policy, Enum.any?(edge.ids, &(&1 in waiting)))
          {edge.key, edge |> edge_numbers(edges, sample, heat) |> Map.put(:faded, faded?)}
        end),
      nodes:
        Map.new(graph.nodes, fn node -> {node.key, node_numbers(node, nodes, states, heat)} end)
    }
  end

  defp heat_values(_graph, _sample, "none"), do: {%{}, %{}}

  defp heat_values(graph, sample, heat) do
    {:ok, %{of: of}} = Stats.fetch(heat)

    edges =
      graph.edges
      |> merged_values(sample.edges, heat)
      |> Map.new(fn {key, v} -> {key, Stats.heat_value(heat, v)} end)

    case of do
      :node -> {%{}, merged_values(graph.nodes, sample.nodes, heat)}
      # A component is as hot as its hottest input.
      :edge -> {edges, hottest_inputs(graph, edges)}
    end
  end

  defp merged_values(items, samples, heat) do
    for item <- items, %{^heat => value} <- [merge_samples(item.ids, samples)], into: %{} do
      {item.key, value}
    end
  end

  defp hottest_inputs(graph, edges) do
    Enum.reduce(graph.edges, %{}, fn edge, acc ->
      Map.update(acc, edge.to, edges[edge.key] || 0, &max(&1, edges[edge.key] || 0))
    end)
  end

  defp merge_samples(ids, samples) do
    Stats.merge_values(for(id <- ids, %{^id => values} <- [samples], do: values))
  end

  defp edge_numbers(edge, heats, sample, heat) do
    values = merge_samples(edge.ids, sample.edges)
    shown = if match?({:ok, %{of: :edge}}, Stats.fetch(heat)), do: heat, else: "processed_rate"

    %{
      heat: relative_heat(heats, edge.key),
      text: Stats.format_value(shown, values[shown]),
      throttled: (values["throttled"] || 0) > 0
    }
  end

  defp node_numbers(node, heats, states, heat) do
    members = for id <- node.ids, %{^id => member} <- [states], do: member

    %{
      heat: relative_heat(heats, node.key),
      text:
        if(match?({:ok, %{of: :node}}, Stats.fetch(heat)),
          do: Stats.format_value(heat, heats[node.key]),
          else: ""
        ),
      state: combined_state(members),
      errors: members |> Enum.map(& &1.errors) |> Enum.sum()
    }
  end

  defp combined_state(members) do
    states = Enum.map(members, & &1.state)

    cond do
      :failed in states -> "failed"
      states != [] and Enum.all?(states, &(&1 == :closed)) -> "closed"
      true -> "running"
    end
  end

  defp relative_heat(heats, key) do
    case {heats[key], heats |> Map.values() |> Enum.max(fn -> 0 end)} do
      {value, largest} when is_number(value) and largest > 0 -> Float.round(value / largest, 3)
      _ -> 0
    end
  end

  @doc "Builds the message with one sample of the plotted statistics of the selection."
  def point_message(sample, selected, folded, snapshot, stats) do
    {kind, ids} = resolve_selection(selected, folded, snapshot)
    values = merge_samples(ids, Map.get(sample, kind, %{}))
    %{key: selected, at: to_milliseconds(sample.at), values: Map.new(stats, &{&1, values[&1]})}
  end

  @doc "Builds the message with all samples of the plotted statistics of the selection, oldest first."
  def series_message(samples, selected, folded, snapshot, stats) do
    {kind, ids} = resolve_selection(selected, folded, snapshot)

    rows =
      for sample <- samples do
        values = merge_samples(ids, Map.get(sample, kind, %{}))
        [to_milliseconds(sample.at) | Enum.map(stats, &values[&1])]
      end

    %{key: selected, stats: stats, rows: rows}
  end

  defp to_milliseconds(ns), do: div(ns, 1_000_000)

  @doc "Resolves a key of the page to its components or connections: `{:edges | :nodes, ids}`."
  @spec resolve_selection(String.t() | nil, MapSet.t(), Situ.Diagnostics.Snapshot.t()) ::
          {:edges | :nodes | :none, [integer()]}
  def resolve_selection("n" <> id, _folded, _snapshot), do: {:nodes, parse_ids(id)}
  def resolve_selection("e" <> ids, _folded, _snapshot), do: {:edges, parse_ids(ids)}

  def resolve_selection("s:" <> path, _folded, snapshot) do
    {:nodes, for(node <- snapshot.nodes, scope_within?(node.scope, path), do: node.id)}
  end

  def resolve_selection(_, _, _), do: {:none, []}

  defp scope_within?(nil, _), do: false
  defp scope_within?(scope, path), do: scope == path or String.starts_with?(scope, path <> ".")

  # Keys come from the page's address, so invalid parts are ignored.
  defp parse_ids(text) do
    for part <- String.split(text, "+"), {id, ""} <- [Integer.parse(part)], do: id
  end
end

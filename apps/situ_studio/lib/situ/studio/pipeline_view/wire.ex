defmodule Situ.Studio.PipelineView.Wire do
  @moduledoc false
  # Builds the messages to the page's hooks: the graph when its shape changes, statistics and colours at each tick, and
  # points of the plots.
  alias Situ.Studio.PipelineView.{Fold, Marking, Stats, Waits}

  @doc "Builds the message with the graph; `way` is its direction (`Marking.directions/0`)."
  @spec graph(Fold.t(), String.t()) :: map()
  def graph(%Fold{} = graph, way \\ "LR") do
    %{
      way: way,
      nodes: Enum.map(graph.nodes, &Map.take(&1, [:key, :label, :kind, :parent, :path, :joins])),
      boxes: Enum.map(graph.boxes, &Map.take(&1, [:key, :label, :path, :parent])),
      edges:
        Enum.map(graph.edges, &Map.take(&1, [:key, :from, :to, :label, :policy, :lossy, :inline]))
    }
  end

  @doc "Builds the message with the heat of edges and nodes (0 to 1, relative to the largest), their texts and states."
  @spec stats(
          Fold.t(),
          Situ.Diagnostics.Snapshot.t(),
          Stats.sample(),
          {heat :: String.t(), mark :: String.t()},
          String.t() | nil
        ) ::
          map()
  def stats(graph, snapshot, sample, {heat, mark}, selected) do
    states = Map.new(snapshot.nodes, &{&1.id, &1})
    {edges, nodes} = heats(graph, sample, heat)
    waiting = if mark == "waits", do: for(w <- Waits.of(snapshot, sample), do: w.edge), else: []

    %{
      selected: selected,
      edges:
        Map.new(graph.edges, fn edge ->
          faded? = Marking.faded?(mark, edge.policy, Enum.any?(edge.ids, &(&1 in waiting)))
          {edge.key, edge |> edge_numbers(edges, sample, heat) |> Map.put(:faded, faded?)}
        end),
      nodes:
        Map.new(graph.nodes, fn node -> {node.key, node_numbers(node, nodes, states, heat)} end)
    }
  end

  defp heats(_graph, _sample, "none"), do: {%{}, %{}}

  defp heats(graph, sample, heat) do
    {:ok, %{of: of}} = Stats.fetch(heat)

    edges =
      graph.edges
      |> values(sample.edges, heat)
      |> Map.new(fn {key, v} -> {key, Stats.warmth(heat, v)} end)

    case of do
      :node -> {%{}, values(graph.nodes, sample.nodes, heat)}
      # A component is as hot as its hottest input.
      :edge -> {edges, inputs(graph, edges)}
    end
  end

  defp values(items, samples, heat) do
    for item <- items, %{^heat => value} <- [merged(item.ids, samples)], into: %{} do
      {item.key, value}
    end
  end

  defp inputs(graph, edges) do
    Enum.reduce(graph.edges, %{}, fn edge, acc ->
      Map.update(acc, edge.to, edges[edge.key] || 0, &max(&1, edges[edge.key] || 0))
    end)
  end

  defp merged(ids, samples) do
    Stats.merge(for(id <- ids, %{^id => values} <- [samples], do: values))
  end

  defp edge_numbers(edge, heats, sample, heat) do
    values = merged(edge.ids, sample.edges)
    shown = if match?({:ok, %{of: :edge}}, Stats.fetch(heat)), do: heat, else: "processed_rate"

    %{
      heat: warmth(heats, edge.key),
      text: Stats.format(shown, values[shown]),
      throttled: (values["throttled"] || 0) > 0
    }
  end

  defp node_numbers(node, heats, states, heat) do
    members = for id <- node.ids, %{^id => member} <- [states], do: member

    %{
      heat: warmth(heats, node.key),
      text:
        if(match?({:ok, %{of: :node}}, Stats.fetch(heat)),
          do: Stats.format(heat, heats[node.key]),
          else: ""
        ),
      state: state(members),
      errors: members |> Enum.map(& &1.errors) |> Enum.sum()
    }
  end

  defp state(members) do
    states = Enum.map(members, & &1.state)

    cond do
      :failed in states -> "failed"
      states != [] and Enum.all?(states, &(&1 == :closed)) -> "closed"
      true -> "running"
    end
  end

  defp warmth(heats, key) do
    case {heats[key], heats |> Map.values() |> Enum.max(fn -> 0 end)} do
      {value, largest} when is_number(value) and largest > 0 -> Float.round(value / largest, 3)
      _ -> 0
    end
  end

  @doc "Builds the message with one sample of the plotted statistics of the selection."
  def point(sample, selected, folded, snapshot, stats) do
    {kind, ids} = selection(selected, folded, snapshot)
    values = merged(ids, Map.get(sample, kind, %{}))
    %{key: selected, at: milliseconds(sample.at), values: Map.new(stats, &{&1, values[&1]})}
  end

  @doc "Builds the message with all samples of the plotted statistics of the selection, oldest first."
  def series(samples, selected, folded, snapshot, stats) do
    {kind, ids} = selection(selected, folded, snapshot)

    rows =
      for sample <- samples do
        values = merged(ids, Map.get(sample, kind, %{}))
        [milliseconds(sample.at) | Enum.map(stats, &values[&1])]
      end

    %{key: selected, stats: stats, rows: rows}
  end

  defp milliseconds(ns), do: div(ns, 1_000_000)

  @doc "Resolves a key of the page to its components or connections: `{:edges | :nodes, ids}`."
  @spec selection(String.t() | nil, MapSet.t(), Situ.Diagnostics.Snapshot.t()) ::
          {:edges | :nodes | :none, [integer()]}
  def selection("n" <> id, _folded, _snapshot), do: {:nodes, ids(id)}
  def selection("e" <> ids, _folded, _snapshot), do: {:edges, ids(ids)}

  def selection("s:" <> path, _folded, snapshot) do
    {:nodes, for(node <- snapshot.nodes, within?(node.scope, path), do: node.id)}
  end

  def selection(_, _, _), do: {:none, []}

  defp within?(nil, _), do: false
  defp within?(scope, path), do: scope == path or String.starts_with?(scope, path <> ".")

  # Keys come from the page's address, so invalid parts are ignored.
  defp ids(text) do
    for part <- String.split(text, "+"), {id, ""} <- [Integer.parse(part)], do: id
  end
end

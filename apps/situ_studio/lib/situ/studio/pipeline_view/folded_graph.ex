defmodule Situ.Studio.PipelineView.FoldedGraph do
  @moduledoc false
  # Builds the graph of a pipeline with some of its composites folded. A folded composite is a
  # single box without its components. Connections that cross its border end at the box, and
  # several connections between the same two ends are merged.
  #
  # The page identifies objects by keys: `"n3"` is a component, `"s:Mouth.Crop"` a composite,
  # `"e5"` a connection and `"e5+7"` several connections.
  alias Situ.Diagnostics.Snapshot

  defstruct nodes: [], boxes: [], edges: []

  @type t :: %__MODULE__{
          nodes: [map()],
          boxes: [
            %{key: String.t(), path: String.t(), label: String.t(), parent: String.t() | nil}
          ],
          edges: [map()]
        }

  # If a pipeline has more components than this, its composites start out folded.
  @many 40

  @doc "Returns the composites that are folded by default."
  @spec default_folded(Snapshot.t()) :: MapSet.t(String.t())
  def default_folded(%Snapshot{nodes: nodes, scopes: scopes}) do
    if length(nodes) > @many,
      do: scopes |> Enum.filter(&(parent_scope(&1, scopes) == nil)) |> MapSet.new(),
      else: MapSet.new()
  end

  @doc "Builds the graph with these composites folded."
  @spec fold_graph(Snapshot.t(), MapSet.t(String.t())) :: t()
  def fold_graph(%Snapshot{} = snapshot, folded) do
    scopes = snapshot.scopes
    places = Map.new(snapshot.nodes, &{&1.id, visible_position(&1, scopes, folded)})

    hidden =
      for scope <- scopes, outermost_folded(scope, scopes, folded) not in [nil, scope], do: scope

    visible =
      for node <- snapshot.nodes, places[node.id] == {:node, node.id}, do: node_entry(node)

    boxes =
      for scope <- scopes, scope not in hidden do
        %{
          key: "s:" <> scope,
          path: scope,
          label: scope_label(scope, scopes),
          parent: scope_key(parent_scope(scope, scopes))
        }
      end

    {closed, open} = Enum.split_with(boxes, &MapSet.member?(folded, &1.path))

    %__MODULE__{
      nodes: visible ++ Enum.map(closed, &folded_entry(&1, snapshot, places)),
      boxes: open,
      edges: merged_edges(snapshot, places)
    }
  end

  defp visible_position(node, scopes, folded) do
    case outermost_folded(node.scope, scopes, folded) do
      nil -> {:node, node.id}
      scope -> {:scope, scope}
    end
  end

  # Returns the outermost folded composite around (or at) a scope.
  defp outermost_folded(nil, _, _), do: nil

  defp outermost_folded(scope, scopes, folded) do
    case {outermost_folded(parent_scope(scope, scopes), scopes, folded),
          MapSet.member?(folded, scope)} do
      {nil, true} -> scope
      {found, _} -> found
    end
  end

  # Names may contain dots, so the parent is the longest scope that this scope's path begins with.
  defp parent_scope(scope, scopes) do
    scopes
    |> Enum.filter(&String.starts_with?(scope, &1 <> "."))
    |> Enum.max_by(&String.length/1, fn -> nil end)
  end

  defp scope_label(scope, scopes) do
    case parent_scope(scope, scopes) do
      nil -> scope
      parent -> String.replace_prefix(scope, parent <> ".", "")
    end
  end

  defp scope_key(nil), do: nil
  defp scope_key(scope), do: "s:" <> scope

  defp node_entry(node) do
    %{
      key: "n#{node.id}",
      ids: [node.id],
      label: node_label(node),
      path: node.path,
      kind: node.kind,
      parent: scope_key(node.scope),
      joins: length(node.inputs) > 1
    }
  end

  defp node_label(%{scope: nil, path: path}), do: path
  defp node_label(%{scope: scope, path: path}), do: String.replace_prefix(path, scope <> ".", "")

  defp folded_entry(box, snapshot, places) do
    ids = for node <- snapshot.nodes, places[node.id] == {:scope, box.path}, do: node.id

    box
    |> Map.merge(%{ids: ids, kind: :composite, joins: false})
    |> Map.put(:label, "#{box.label} (#{length(ids)})")
  end

  defp merged_edges(snapshot, places) do
    snapshot.edges
    |> Enum.map(&{&1, place_key(places[&1.from]), place_key(places[&1.to])})
    |> Enum.reject(fn {_, from, to} -> from == to and String.starts_with?(from, "s:") end)
    |> Enum.group_by(fn {edge, from, to} -> edge_group(edge, from, to) end)
    |> Enum.map(fn {_, [{first, from, to} | _] = group} ->
      edges = Enum.map(group, &elem(&1, 0))

      %{
        key: "e" <> Enum.map_join(edges, "+", &Integer.to_string(&1.id)),
        ids: Enum.map(edges, & &1.id),
        from: from,
        to: to,
        label: if(match?([_], edges), do: first.to_input, else: "#{length(edges)} connections"),
        policy: edge_policies(edges),
        lossy: Enum.any?(edges, &lossy?/1),
        inline: Enum.all?(edges, &(&1.kind == :inline))
      }
    end)
    |> Enum.sort_by(& &1.ids)
  end

  # Connections between two components are drawn separately; connections to a folded box are merged.
  defp edge_group(edge, "n" <> _, "n" <> _), do: edge.id
  defp edge_group(_edge, from, to), do: {from, to}

  defp place_key({:node, id}), do: "n#{id}"
  defp place_key({:scope, scope}), do: "s:" <> scope

  defp edge_policies(edges), do: edges |> Enum.map(& &1.policy) |> Enum.uniq() |> Enum.join(", ")

  @doc """
  Returns whether a connection may drop messages.

      iex> alias Situ.Studio.PipelineView.FoldedGraph
      iex> for policy <- ["unlimited", "throttle(8)", "latest"], do: FoldedGraph.lossy?(%{policy: policy})
      [false, false, true]
  """
  @spec lossy?(%{:policy => String.t() | nil, optional(atom()) => term()}) :: boolean()
  def lossy?(%{policy: nil}), do: false

  def lossy?(%{policy: policy}),
    do: policy not in ["unlimited", "synchronous"] and not String.starts_with?(policy, "throttle")
end

defmodule Situ.Studio.PipelineView.Fold do
  @moduledoc """
  Builds the graph of a pipeline with some of its composites folded. A folded composite is a single box without its
  components. Connections that cross its border end at the box, and several connections between the same two ends are
  merged.

  The page identifies objects by keys: `"n3"` is a component, `"s:Mouth.Crop"` a composite, `"e5"` a connection and
  `"e5+7"` several connections.
  """
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
  @spec default(Snapshot.t()) :: MapSet.t(String.t())
  def default(%Snapshot{nodes: nodes, scopes: scopes}) do
    if length(nodes) > @many,
      do: scopes |> Enum.filter(&(parent(&1, scopes) == nil)) |> MapSet.new(),
      else: MapSet.new()
  end

  @doc "Builds the graph with these composites folded."
  @spec apply(Snapshot.t(), MapSet.t(String.t())) :: t()
  def apply(%Snapshot{} = snapshot, folded) do
    scopes = snapshot.scopes
    places = Map.new(snapshot.nodes, &{&1.id, place(&1, scopes, folded)})
    hidden = for scope <- scopes, outer(scope, scopes, folded) not in [nil, scope], do: scope

    visible = for node <- snapshot.nodes, places[node.id] == {:node, node.id}, do: shown(node)

    boxes =
      for scope <- scopes, scope not in hidden do
        %{
          key: "s:" <> scope,
          path: scope,
          label: label(scope, scopes),
          parent: key(parent(scope, scopes))
        }
      end

    {closed, open} = Enum.split_with(boxes, &MapSet.member?(folded, &1.path))

    %__MODULE__{
      nodes: visible ++ Enum.map(closed, &closed(&1, snapshot, places)),
      boxes: open,
      edges: edges(snapshot, places)
    }
  end

  defp place(node, scopes, folded) do
    case outer(node.scope, scopes, folded) do
      nil -> {:node, node.id}
      scope -> {:scope, scope}
    end
  end

  # Returns the outermost folded composite around (or at) a scope.
  defp outer(nil, _, _), do: nil

  defp outer(scope, scopes, folded) do
    case {outer(parent(scope, scopes), scopes, folded), MapSet.member?(folded, scope)} do
      {nil, true} -> scope
      {found, _} -> found
    end
  end

  # Names may contain dots, so the parent is the longest scope that this scope's path begins with.
  defp parent(scope, scopes) do
    scopes
    |> Enum.filter(&String.starts_with?(scope, &1 <> "."))
    |> Enum.max_by(&String.length/1, fn -> nil end)
  end

  defp label(scope, scopes) do
    case parent(scope, scopes) do
      nil -> scope
      parent -> String.replace_prefix(scope, parent <> ".", "")
    end
  end

  defp key(nil), do: nil
  defp key(scope), do: "s:" <> scope

  defp shown(node) do
    %{
      key: "n#{node.id}",
      ids: [node.id],
      label: short(node),
      path: node.path,
      kind: node.kind,
      parent: key(node.scope),
      joins: length(node.inputs) > 1
    }
  end

  defp short(%{scope: nil, path: path}), do: path
  defp short(%{scope: scope, path: path}), do: String.replace_prefix(path, scope <> ".", "")

  defp closed(box, snapshot, places) do
    ids = for node <- snapshot.nodes, places[node.id] == {:scope, box.path}, do: node.id

    box
    |> Map.merge(%{ids: ids, kind: :composite, joins: false})
    |> Map.put(:label, "#{box.label} (#{length(ids)})")
  end

  defp edges(snapshot, places) do
    snapshot.edges
    |> Enum.map(&{&1, place_key(places[&1.from]), place_key(places[&1.to])})
    |> Enum.reject(fn {_, from, to} -> from == to and String.starts_with?(from, "s:") end)
    |> Enum.group_by(fn {edge, from, to} -> group(edge, from, to) end)
    |> Enum.map(fn {_, [{first, from, to} | _] = group} ->
      edges = Enum.map(group, &elem(&1, 0))

      %{
        key: "e" <> Enum.map_join(edges, "+", &Integer.to_string(&1.id)),
        ids: Enum.map(edges, & &1.id),
        from: from,
        to: to,
        label: if(match?([_], edges), do: first.to_input, else: "#{length(edges)} connections"),
        policy: policy(edges),
        lossy: Enum.any?(edges, &lossy?/1),
        inline: Enum.all?(edges, &(&1.kind == :inline))
      }
    end)
    |> Enum.sort_by(& &1.ids)
  end

  # Connections between two components are drawn separately; connections to a folded box are merged.
  defp group(edge, "n" <> _, "n" <> _), do: edge.id
  defp group(_edge, from, to), do: {from, to}

  defp place_key({:node, id}), do: "n#{id}"
  defp place_key({:scope, scope}), do: "s:" <> scope

  defp policy(edges), do: edges |> Enum.map(& &1.policy) |> Enum.uniq() |> Enum.join(", ")

  @doc """
  Returns whether a connection may drop messages.

      iex> alias Situ.Studio.PipelineView.Fold
      iex> for policy <- ["unlimited", "throttle(8)", "latest"], do: Fold.lossy?(%{policy: policy})
      [false, false, true]
  """
  @spec lossy?(%{:policy => String.t() | nil, optional(atom()) => term()}) :: boolean()
  def lossy?(%{policy: nil}), do: false

  def lossy?(%{policy: policy}),
    do: policy not in ["unlimited", "synchronous"] and not String.starts_with?(policy, "throttle")
end

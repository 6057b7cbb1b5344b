defmodule Situ.Cluster.Placement do
  @moduledoc false
  # Determines the preferred nodes for a part among the current members. Pure. Members may have different information
  # about each other at a given moment; then two of them try to run the part, and the lease decides.

  @typedoc "Labels, devices, the load of the machine (0 to 1), and round trips to other nodes (ns)."
  @type member :: %{
          labels: [String.t()],
          devices: [String.t()],
          machine: float(),
          trips: %{node() => non_neg_integer()}
        }
  @type members :: %{node() => member()}

  # Load is rounded, so that small changes from second to second do not change the order.
  @steps 4

  @spec build_member(map()) :: member()
  def build_member(info),
    do: Map.merge(%{labels: [], devices: [], machine: 0.0, trips: %{}}, info)

  @doc "Returns the rank of `node` in the order of preference (0 is first), or `nil` when it may not run the part."
  @spec node_rank(members(), map(), String.t(), node()) :: non_neg_integer() | nil
  def node_rank(members, rule, part, node),
    do: members |> preferred_nodes(rule, part) |> Enum.find_index(&(&1 == node))

  @doc """
  Returns the nodes that may run a part, preferred ones first. They are followed by the nodes that no rule names, the
  least busy machines first; a hash orders nodes of equal load.
  """
  @spec preferred_nodes(members(), map(), String.t()) :: [node()]
  def preferred_nodes(members, rule, part) do
    named = rule.on |> Enum.flat_map(&matching_nodes(members, &1, rule.only)) |> Enum.uniq()

    others =
      members |> Map.keys() |> Enum.sort_by(&load_order(members, part, &1)) |> Kernel.--(named)

    if rule.only and rule.on != [], do: named, else: named ++ others
  end

  defp load_order(members, part, node),
    do: {round(members[node].machine * @steps), :erlang.phash2({part, node})}

  @doc "Returns the nodes that a rule prefers equally, before all others."
  @spec best_nodes(members(), map()) :: [node()]
  def best_nodes(members, %{on: []}), do: Map.keys(members)
  def best_nodes(members, %{on: [first | _]}), do: matching_nodes(members, first, true)

  @doc """
  Returns the node for the branch of `key`, from the nodes that the rule prefers, or from all members if it matches
  none and is not `only`. Keys are spread evenly, and only the keys of a lost node move to other nodes.
  """
  @spec choose_branch_node(members(), map(), term()) :: node() | nil
  def choose_branch_node(members, rule, key) do
    case best_nodes(members, rule) do
      [] when rule.only -> nil
      [] -> choose_branch_node(members, %{rule | on: []}, key)
      nodes -> Enum.max_by(nodes, &:erlang.phash2({key, &1}))
    end
  end

  defp matching_nodes(members, node, _only) when is_atom(node),
    do: if(is_map_key(members, node), do: [node], else: [])

  # Returns the nodes that have the device, then all others, nearest first.
  defp matching_nodes(members, {:near, device}, only) do
    {equipped, others} =
      members |> Map.keys() |> Enum.split_with(&(device in members[&1].devices))

    if only or equipped == [],
      do: equipped,
      else: equipped ++ Enum.sort_by(others, &nearest_trip(members[&1], equipped))
  end

  defp matching_nodes(members, label, _only) do
    for {node, %{labels: labels}} <- members,
        label in labels or label == Atom.to_string(node),
        do: node
  end

  # Atoms are greater than numbers, so a node without a measured round trip is last.
  defp nearest_trip(member, equipped),
    do: equipped |> Enum.map(&Map.get(member.trips, &1, :far)) |> Enum.min()
end

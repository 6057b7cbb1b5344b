defmodule Situ.Cluster.Placement do
  @moduledoc false
  # Which node is preferred for a part, among the members there are. Pure: all members come to the same order.

  @type members :: %{node() => [String.t()]}

  @doc "The place of `node` in the order of preference (0 is first), or `nil` when it may not run the part."
  @spec rank(members(), map(), String.t(), node()) :: non_neg_integer() | nil
  def rank(members, rule, part, node),
    do: members |> order(rule, part) |> Enum.find_index(&(&1 == node))

  @doc "The nodes that may run a part, the preferred ones first; those that no rule names follow, spread by hash."
  @spec order(members(), map(), String.t()) :: [node()]
  def order(members, rule, part) do
    named = rule.on |> Enum.flat_map(&matching(members, &1)) |> Enum.uniq()

    others =
      members |> Map.keys() |> Enum.sort_by(&:erlang.phash2({part, &1})) |> Kernel.--(named)

    if rule.only and rule.on != [], do: named, else: named ++ others
  end

  defp matching(members, node) when is_atom(node),
    do: if(is_map_key(members, node), do: [node], else: [])

  defp matching(members, label) do
    for {node, labels} <- members, label in labels or label == Atom.to_string(node), do: node
  end
end

defmodule Situ.Cluster.Placement do
  @moduledoc false
  # Which node is preferred for a part, among the members there are. Pure. Members may differ in what they know of one
  # another at a moment: then two of them try, and the lease decides.

  @typedoc "Labels, devices, the busy part of the machine (0 to 1), round trips to others (ns)."
  @type member :: %{
          labels: [String.t()],
          devices: [String.t()],
          machine: float(),
          trips: %{node() => non_neg_integer()}
        }
  @type members :: %{node() => member()}

  # Load is rounded to steps, so that small changes from second to second do not change the order.
  @steps 4

  @spec member(map()) :: member()
  def member(known), do: Map.merge(%{labels: [], devices: [], machine: 0.0, trips: %{}}, known)

  @doc "The place of `node` in the order of preference (0 is first), or `nil` when it may not run the part."
  @spec rank(members(), map(), String.t(), node()) :: non_neg_integer() | nil
  def rank(members, rule, part, node),
    do: members |> order(rule, part) |> Enum.find_index(&(&1 == node))

  @doc """
  The nodes that may run a part, the preferred ones first; those that no rule names follow, the least busy machines
  before others, and spread by hash among equals.
  """
  @spec order(members(), map(), String.t()) :: [node()]
  def order(members, rule, part) do
    named = rule.on |> Enum.flat_map(&matching(members, &1, rule.only)) |> Enum.uniq()

    others =
      members |> Map.keys() |> Enum.sort_by(&by_load(members, part, &1)) |> Kernel.--(named)

    if rule.only and rule.on != [], do: named, else: named ++ others
  end

  defp by_load(members, part, node),
    do: {round(members[node].machine * @steps), :erlang.phash2({part, node})}

  @doc "The nodes that a rule allows a part to run on without being second best."
  @spec equals(members(), map()) :: [node()]
  def equals(members, %{on: []}), do: Map.keys(members)
  def equals(members, %{on: [first | _]}), do: matching(members, first, true)

  defp matching(members, node, _only) when is_atom(node),
    do: if(is_map_key(members, node), do: [node], else: [])

  # The nodes that have the device, then all others, the nearest first.
  defp matching(members, {:near, device}, only) do
    {having, others} = members |> Map.keys() |> Enum.split_with(&(device in members[&1].devices))

    if only or having == [],
      do: having,
      else: having ++ Enum.sort_by(others, &far(members[&1], having))
  end

  defp matching(members, label, _only) do
    for {node, %{labels: labels}} <- members,
        label in labels or label == Atom.to_string(node),
        do: node
  end

  # Atoms are greater than numbers: who has not measured it is last.
  defp far(member, having), do: having |> Enum.map(&Map.get(member.trips, &1, :far)) |> Enum.min()
end

defmodule Situ.Cluster.Balance do
  @moduledoc """
  Which part should move, so that no node is busy while another idles. Pure.

  A part moves from the busiest node that has one to move, to the idlest node that its rule allows as well, when the
  busier of the two is then less busy by a tenth of a core at least: moving costs a checkpoint, and what swings is not
  worth one.

      iex> nodes = %{a@h: %{busy: 1.8, cores: 2}, b@h: %{busy: 0.1, cores: 2}}
      iex> lips = %{part: "Lips", node: :a@h, cost: 1.0, on: [:a@h, :b@h]}
      iex> parts = [lips, %{part: "Sound", node: :a@h, cost: 0.7, on: [:a@h]}]
      iex> Situ.Cluster.Balance.move(nodes, parts)
      {"Lips", :b@h}
      iex> Situ.Cluster.Balance.move(%{nodes | a@h: %{busy: 0.15, cores: 2}}, parts)
      nil
  """

  @least 0.1

  @type nodes :: %{node() => %{busy: float(), cores: pos_integer()}}
  @type part :: %{part: String.t(), node: node(), cost: float(), on: [node()]}

  @doc "The one move that helps most, or `nil`."
  @spec move(nodes(), [part()]) :: {String.t(), node()} | nil
  def move(nodes, parts) do
    tried =
      for %{part: part, node: from, cost: cost, on: on} <- parts,
          is_map_key(nodes, from),
          to <- on,
          to != from and is_map_key(nodes, to),
          gain = gain(nodes[from], nodes[to], cost),
          gain > @least,
          do: {gain, part, to}

    with [_ | _] <- tried do
      {_, part, to} = Enum.max_by(tried, fn {gain, part, to} -> {gain, part, to} end)
      {part, to}
    else
      [] -> nil
    end
  end

  # By how many cores the busier of the two is less busy, as parts of a core of each.
  defp gain(from, to, cost) do
    before = max(from.busy / from.cores, to.busy / to.cores)
    behind = max((from.busy - cost) / from.cores, (to.busy + cost) / to.cores)
    (before - behind) * min(from.cores, to.cores)
  end
end

defmodule Situ.Cluster.LoadBalance do
  @moduledoc false
  # Chooses a part to move when one node is busy and another is idle. Pure.
  #
  # A part moves from the busiest node that has a movable part to the idlest node that its rule
  # allows, provided that the busier of the two nodes then has at least a tenth of a core less
  # load. A move costs a checkpoint, so smaller and fluctuating differences are not worth it.

  @min_gain 0.1

  @type nodes :: %{node() => %{busy: float(), cores: pos_integer()}}
  @type part :: %{part: String.t(), node: node(), cost: float(), on: [node()]}

  @doc """
  Returns the part and target node of the most effective move, or `nil`.

      iex> nodes = %{a@h: %{busy: 1.8, cores: 2}, b@h: %{busy: 0.1, cores: 2}}
      iex> lips = %{part: "Lips", node: :a@h, cost: 1.0, on: [:a@h, :b@h]}
      iex> parts = [lips, %{part: "Sound", node: :a@h, cost: 0.7, on: [:a@h]}]
      iex> Situ.Cluster.LoadBalance.choose_move(nodes, parts)
      {"Lips", :b@h}
      iex> Situ.Cluster.LoadBalance.choose_move(%{nodes | a@h: %{busy: 0.15, cores: 2}}, parts)
      nil
  """
  @spec choose_move(nodes(), [part()]) :: {String.t(), node()} | nil
  def choose_move(nodes, parts) do
    moves =
      for %{part: part, node: from, cost: cost, on: on} <- parts,
          is_map_key(nodes, from),
          to <- on,
          to != from and is_map_key(nodes, to),
          gain = move_gain(nodes[from], nodes[to], cost),
          gain > @min_gain,
          do: {gain, part, to}

    with [_ | _] <- moves do
      {_, part, to} = Enum.max_by(moves, fn {gain, part, to} -> {gain, part, to} end)
      {part, to}
    else
      [] -> nil
    end
  end

  # Returns by how many cores the load of the busier node falls.
  defp move_gain(from, to, cost) do
    load_before = max(from.busy / from.cores, to.busy / to.cores)
    load_after = max((from.busy - cost) / from.cores, (to.busy + cost) / to.cores)
    (load_before - load_after) * min(from.cores, to.cores)
  end
end

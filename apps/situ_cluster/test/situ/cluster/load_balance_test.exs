defmodule Situ.Cluster.LoadBalanceTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  alias Situ.Cluster.LoadBalance
  doctest LoadBalance

  defp some_nodes do
    map(list({integer(0, 40), integer(1, 8)}), fn list ->
      for {{busy, cores}, i} <- Enum.with_index(list),
          into: %{},
          do: {:"n#{i}", %{busy: busy / 10, cores: cores}}
    end)
  end

  # Repeated moves must end and never make the busiest node busier.
  property "moves end, and each one lowers the load of the busier of the two nodes", numtests: 200 do
    forall {nodes, costs} <- {some_nodes(), list(integer(0, 20))} do
      names = Map.keys(nodes)

      parts =
        for {cost, i} <- Enum.with_index(costs), names != [] do
          %{
            part: "p#{i}",
            node: Enum.at(names, rem(i, length(names))),
            cost: cost / 10,
            on: names
          }
        end

      moved(nodes, parts, 200)
    end
  end

  defp moved(_nodes, _parts, 0), do: false

  defp moved(nodes, parts, left) do
    case LoadBalance.choose_move(nodes, parts) do
      nil ->
        true

      {name, to} ->
        part = Enum.find(parts, &(&1.part == name))
        shift = fn nodes, node, by -> update_in(nodes[node].busy, &(&1 + by)) end
        later = nodes |> shift.(part.node, -part.cost) |> shift.(to, part.cost)
        parts = for p <- parts, do: if(p.part == name, do: %{p | node: to}, else: p)

        load = fn nodes ->
          Enum.max(for n <- [part.node, to], do: nodes[n].busy / nodes[n].cores)
        end

        load.(later) < load.(nodes) and moved(later, parts, left - 1)
    end
  end
end

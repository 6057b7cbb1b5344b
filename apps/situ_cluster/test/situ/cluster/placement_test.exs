defmodule Situ.Cluster.PlacementTest do
  use ExUnit.Case, async: true

  alias Situ.Cluster.Placement

  defp members(known),
    do: Map.new(known, fn {node, member} -> {node, Placement.build_member(member)} end)

  defp labelled do
    members(%{
      a@h: %{labels: ["camera"]},
      b@h: %{labels: ["compute"]},
      c@h: %{labels: ["compute", "big"]}
    })
  end

  test "orders nodes and labels by the rule, then all others" do
    rule = %{on: ["big", :a@h], only: false}
    assert Placement.preferred_nodes(labelled(), rule, "Lips") == [:c@h, :a@h, :b@h]
    assert Placement.node_rank(labelled(), rule, "Lips", :b@h) == 2
    assert Placement.best_nodes(labelled(), %{on: ["compute", :a@h], only: false}) == [:b@h, :c@h]
  end

  test "includes only the rule's nodes on request, and ignores missing nodes" do
    rule = %{on: ["camera", :z@h], only: true}
    assert Placement.preferred_nodes(labelled(), rule, "Lips") == [:a@h]
    assert Placement.node_rank(labelled(), rule, "Lips", :b@h) == nil
  end

  test "without a rule, parts spread over all nodes" do
    rule = %{on: [], only: false}
    firsts = for i <- 1..60, do: hd(Placement.preferred_nodes(labelled(), rule, "part#{i}"))
    assert firsts |> Enum.uniq() |> length() == 3
  end

  test "without a rule, the least busy machines come first, despite small changes" do
    at = fn busy -> members(for({n, m} <- busy, into: %{}, do: {n, %{machine: m}})) end
    rule = %{on: [], only: false}

    for i <- 1..20 do
      assert List.last(
               Placement.preferred_nodes(at.(a@h: 0.9, b@h: 0.1, c@h: 0.3), rule, "part#{i}")
             ) ==
               :a@h

      assert Placement.preferred_nodes(at.(a@h: 0.51, b@h: 0.45, c@h: 0.5), rule, "part#{i}") ==
               Placement.preferred_nodes(at.(a@h: 0.45, b@h: 0.55, c@h: 0.48), rule, "part#{i}")
    end
  end

  test "near a device: its node first, then nodes by round trip to it" do
    known =
      members(%{
        a@h: %{trips: %{c@h: 900_000, b@h: 10}},
        b@h: %{trips: %{c@h: 20_000}},
        c@h: %{devices: ["camera0"]},
        d@h: %{}
      })

    rule = %{on: [{:near, "camera0"}], only: false}
    assert Placement.preferred_nodes(known, rule, "Lips") == [:c@h, :b@h, :a@h, :d@h]
    assert Placement.preferred_nodes(known, %{rule | only: true}, "Lips") == [:c@h]
    assert Placement.preferred_nodes(Map.delete(known, :c@h), %{rule | only: true}, "Lips") == []
    assert Placement.best_nodes(known, rule) == [:c@h]
  end
end

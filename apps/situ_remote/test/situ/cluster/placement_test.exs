defmodule Situ.Cluster.PlacementTest do
  use ExUnit.Case, async: true

  alias Situ.Cluster.Placement

  defp members(known),
    do: Map.new(known, fn {node, member} -> {node, Placement.member(member)} end)

  defp labelled do
    members(%{
      a@h: %{labels: ["camera"]},
      b@h: %{labels: ["compute"]},
      c@h: %{labels: ["compute", "big"]}
    })
  end

  test "nodes and labels in the order of the rule, then all others" do
    rule = %{on: ["big", :a@h], only: false}
    assert Placement.order(labelled(), rule, "Lips") == [:c@h, :a@h, :b@h]
    assert Placement.rank(labelled(), rule, "Lips", :b@h) == 2
    assert Placement.equals(labelled(), %{on: ["compute", :a@h], only: false}) == [:b@h, :c@h]
  end

  test "only those, when it says so; a node that is not there does not count" do
    rule = %{on: ["camera", :z@h], only: true}
    assert Placement.order(labelled(), rule, "Lips") == [:a@h]
    assert Placement.rank(labelled(), rule, "Lips", :b@h) == nil
  end

  test "without a rule every node may, and parts spread" do
    rule = %{on: [], only: false}
    firsts = for i <- 1..60, do: hd(Placement.order(labelled(), rule, "part#{i}"))
    assert firsts |> Enum.uniq() |> length() == 3
  end

  test "without a rule the least busy machines come first; what swings a little changes nothing" do
    at = fn busy -> members(for({n, m} <- busy, into: %{}, do: {n, %{machine: m}})) end
    rule = %{on: [], only: false}

    for i <- 1..20 do
      assert List.last(Placement.order(at.(a@h: 0.9, b@h: 0.1, c@h: 0.3), rule, "part#{i}")) ==
               :a@h

      assert Placement.order(at.(a@h: 0.51, b@h: 0.45, c@h: 0.5), rule, "part#{i}") ==
               Placement.order(at.(a@h: 0.45, b@h: 0.55, c@h: 0.48), rule, "part#{i}")
    end
  end

  test "near a device: the node that has it, then those with the shortest way to it" do
    known =
      members(%{
        a@h: %{trips: %{c@h: 900_000, b@h: 10}},
        b@h: %{trips: %{c@h: 20_000}},
        c@h: %{devices: ["camera0"]},
        d@h: %{}
      })

    rule = %{on: [{:near, "camera0"}], only: false}
    assert Placement.order(known, rule, "Lips") == [:c@h, :b@h, :a@h, :d@h]
    assert Placement.order(known, %{rule | only: true}, "Lips") == [:c@h]
    assert Placement.order(Map.delete(known, :c@h), %{rule | only: true}, "Lips") == []
    assert Placement.equals(known, rule) == [:c@h]
  end
end

defmodule Situ.Cluster.PlacementTest do
  use ExUnit.Case, async: true

  alias Situ.Cluster.Placement

  @members %{a@h: ["camera"], b@h: ["compute"], c@h: ["compute", "big"]}

  test "nodes and labels in the order of the rule, then all others" do
    rule = %{on: ["big", :a@h], only: false}
    assert Placement.order(@members, rule, "Lips") == [:c@h, :a@h, :b@h]
    assert Placement.rank(@members, rule, "Lips", :b@h) == 2
  end

  test "only those, when it says so; a node that is not there does not count" do
    rule = %{on: ["camera", :z@h], only: true}
    assert Placement.order(@members, rule, "Lips") == [:a@h]
    assert Placement.rank(@members, rule, "Lips", :b@h) == nil
  end

  test "without a rule every node may, and parts spread" do
    rule = %{on: [], only: false}
    firsts = for i <- 1..60, do: hd(Placement.order(@members, rule, "part#{i}"))
    assert firsts |> Enum.uniq() |> length() == 3
  end
end

defmodule Situ.Studio.ClusterRatesTest do
  use ExUnit.Case, async: true
  alias Situ.Cluster.Overview
  alias Situ.Studio.ClusterRates
  doctest ClusterRates

  test "bytes of links; a count that went back, or that is new, has no rate" do
    at = fn time, links ->
      %Overview{time: time, links: for({a, b} <- links, do: %{node: :n@h, address: a, bytes: b})}
    end

    before = at.(1_000_000_000, [{"a", 100}, {"b", 500}])
    now = at.(3_000_000_000, [{"a", 300}, {"b", 20}, {"c", 7}])
    assert ClusterRates.links(before, now) == %{{:n@h, "a"} => 100.0}
    assert ClusterRates.links(now, now) == %{}
  end
end

defmodule Situ.Studio.ClusterRatesTest do
  use ExUnit.Case, async: true
  alias Situ.Cluster.Overview
  alias Situ.Studio.ClusterRates
  doctest ClusterRates

  test "returns byte rates of links, except for new and restarted counters" do
    at = fn time, links ->
      %Overview{time: time, links: for({a, b} <- links, do: %{node: :n@h, address: a, bytes: b})}
    end

    before = at.(1_000_000_000, [{"a", 100}, {"b", 500}])
    now = at.(3_000_000_000, [{"a", 300}, {"b", 20}, {"c", 7}])
    assert ClusterRates.link_rates(before, now) == %{{:n@h, "a"} => 100.0}
    assert ClusterRates.link_rates(now, now) == %{}
  end
end

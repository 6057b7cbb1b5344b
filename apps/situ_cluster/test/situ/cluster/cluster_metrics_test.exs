defmodule Situ.Cluster.ClusterMetricsTest do
  use ExUnit.Case, async: true
  alias Situ.Cluster.ClusterMetrics

  test "writes the measurements of a node" do
    vital = %{
      busy: 0.5,
      cores: 4,
      machine: 0.25,
      memory: 1,
      devices: [],
      trips: %{:b@host => 2_000_000}
    }

    text = Situ.Metrics.to_text(ClusterMetrics.build(vital, 3))
    assert text =~ "situ_cluster_nodes 3\n"
    assert text =~ "situ_node_busy_cores 0.5\n"
    assert text =~ ~s(situ_round_trip_seconds{peer="b@host"} 0.002\n)
  end

  test "a node outside of a cluster has no metrics, and the module is registered" do
    assert ClusterMetrics in Application.get_env(:situ_cluster, :metrics)
    assert is_list(ClusterMetrics.collect_metrics())
  end
end

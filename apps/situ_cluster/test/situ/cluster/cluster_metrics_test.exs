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

  test "writes the leases of the parts that this node may run" do
    runners = [
      {"lab", %{part: "Mouth", phase: :running, epoch: 7}},
      {"lab", %{part: "Ears", phase: :standby, epoch: nil}}
    ]

    text = Situ.Metrics.to_text(ClusterMetrics.build_leases(runners))
    assert text =~ ~s(situ_cluster_lease_held{deployment="lab",part="Mouth"} 1\n)
    assert text =~ ~s(situ_cluster_lease_held{deployment="lab",part="Ears"} 0\n)
    assert text =~ ~s(situ_cluster_lease_epoch{deployment="lab",part="Mouth"} 7\n)
    refute text =~ ~s(situ_cluster_lease_epoch{deployment="lab",part="Ears"})
  end

  test "a node outside of a cluster has no metrics, and the module is registered" do
    assert ClusterMetrics in Application.get_env(:situ_cluster, :metrics)
    assert is_list(ClusterMetrics.collect_metrics())
  end
end

defmodule Situ.Cluster.ClusterMetrics do
  @moduledoc false
  # The metrics of this node as a member of a cluster, for `Situ.Metrics`: load, and the round trips to other nodes.
  @behaviour Situ.Metrics

  alias Situ.Cluster.NodeMetrics
  alias Situ.Time

  @impl true
  def collect_metrics do
    vitals = NodeMetrics.recent_vitals()

    case vitals[node()] do
      nil -> []
      own -> build(own, map_size(vitals))
    end
  end

  @doc "Builds the metrics from the node's measurements and the number of nodes that were heard of recently."
  @spec build(NodeMetrics.vital(), non_neg_integer()) :: [Situ.Metrics.metric()]
  def build(own, nodes) do
    trips = for {node, ns} <- own.trips, do: {[peer: Atom.to_string(node)], Time.to_seconds(ns)}

    [
      gauge(
        "situ_cluster_nodes",
        "Nodes of the cluster that were heard of in the last seconds.",
        [
          {[], nodes}
        ]
      ),
      gauge("situ_node_busy_cores", "Cores that this node's VM uses.", [{[], own.busy / 1}]),
      gauge("situ_node_cores", "Cores that this node's VM may use.", [{[], own.cores}]),
      gauge("situ_machine_load", "Load of the whole machine, 0 to 1.", [{[], own.machine / 1}]),
      gauge("situ_round_trip_seconds", "Shortest recent round trip to another node.", trips)
    ]
  end

  defp gauge(name, help, samples), do: %{name: name, type: :gauge, help: help, samples: samples}
end

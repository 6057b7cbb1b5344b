defmodule Situ.Cluster.ClusterMetrics do
  @moduledoc false
  # The metrics of this node as a member of a cluster, for `Situ.Metrics`: load, the round trips to other nodes, and
  # the leases of the parts that it may run.
  @behaviour Situ.Metrics

  alias Situ.Cluster.{Agent, Member, NodeMetrics, Runners}
  alias Situ.Time

  # A runner that does not respond for this long is left out, in ms.
  @timeout 2_000

  @impl true
  def collect_metrics do
    vitals = NodeMetrics.recent_vitals()

    case vitals[node()] do
      nil -> []
      own -> build(own, map_size(vitals)) ++ build_leases(list_leases())
    end
  end

  defp list_leases do
    if Process.whereis(Agent),
      do: Enum.flat_map(Member.list_deployments(), &list_leases/1),
      else: []
  end

  defp list_leases(%{name: name}) do
    runners = Map.values(Agent.list_runners(Agent, name, @timeout))
    for %{part: _} = info <- Runners.collect_infos(runners, @timeout), do: {name, info}
  end

  @doc "Builds the metrics of leases from the names of deployments and the states of this node's runners."
  @spec build_leases([{String.t(), map()}]) :: [Situ.Metrics.metric()]
  def build_leases(runners) do
    leases =
      for {deployment, %{part: part} = info} <- runners,
          do: {[deployment: deployment, part: part], info}

    held = for {labels, info} <- leases, do: {labels, if(info.phase == :standby, do: 0, else: 1)}
    epochs = for {labels, %{epoch: n}} when n != nil <- leases, do: {labels, n}

    [
      gauge(
        "situ_cluster_lease_held",
        "Whether this node has the lease of a part (1) or is on standby (0).",
        held
      ),
      gauge(
        "situ_cluster_lease_epoch",
        "Number of the lease that this node has; it changes with every takeover.",
        epochs
      )
    ]
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

defmodule Situ.Cluster.Member do
  @moduledoc false
  # Contains the requests that a part's runner, the inlets of its pipeline and the balancer send to the cluster's
  # agent on their node. None of them waits for the agent, so the agent may wait for them.
  #
  #   {:situ_cluster, :follow, part, pid}            an inlet asks for the publisher of a part
  #   {:situ_cluster, :publisher, part, publisher}   the reply, immediately and whenever the publisher changes

  alias Situ.Cluster.{Agent, Deployment, NodeLease, Placement, NodeMetrics}
  alias Situ.Error

  @table __MODULE__

  @type part :: {deployment :: String.t(), part :: String.t()}

  @doc "Informs the agent that a part is now published by `publisher` on this node."
  @spec announce_publisher(GenServer.server(), part(), pos_integer(), pid()) :: :ok
  def announce_publisher(agent, part, epoch, publisher),
    do: GenServer.cast(agent, {:route, part, epoch, publisher, :tell})

  @doc "Informs the agent that process `runner` is responsible for a part on this node."
  @spec announce_runner(GenServer.server(), part(), pid()) :: :ok
  def announce_runner(agent, part, runner), do: GenServer.cast(agent, {:runs, part, runner})

  @doc "Creates the agent's table of members and deployments, which all processes of the node can read."
  @spec create_table() :: :ok
  def create_table do
    :ets.new(@table, [:named_table, :protected, read_concurrency: true])
    put_members(%{})
    put_deployments([])
    :ok
  end

  @doc "Replaces the members and their labels in the table."
  @spec put_members(%{node() => [String.t()]}) :: true
  def put_members(members), do: :ets.insert(@table, {:members, members})

  @doc "Replaces the deployments in the table."
  @spec put_deployments([Deployment.t()]) :: true
  def put_deployments(deployments), do: :ets.insert(@table, {:deployments, deployments})

  @doc "Returns the deployments that this node knows."
  @spec list_deployments() :: [Deployment.t()]
  def list_deployments, do: lookup_table(:deployments)

  @doc "Returns whether this node is the first of the members."
  @spec first_member?() :: boolean()
  def first_member?,
    do: :members |> lookup_table() |> Map.keys() |> Enum.min(fn -> nil end) == node()

  defp lookup_table(key), do: :ets.lookup_element(@table, key, 2)

  @doc "Returns the members with the properties that placement rules use."
  @spec list_members() :: Placement.members()
  def list_members do
    vitals = NodeMetrics.recent_vitals()

    Map.new(lookup_table(:members), fn {node, labels} ->
      {node, vitals |> Map.get(node, %{}) |> Map.put(:labels, labels) |> Placement.build_member()}
    end)
  end

  @doc "Returns this node's rank for a part (0 is the most preferred), or `nil` if it may not run the part."
  @spec own_rank(map(), String.t()) :: non_neg_integer() | nil
  def own_rank(rule, part), do: Placement.node_rank(list_members(), rule, part, node())

  @doc "Returns the node for the branch of `key`; see `Situ.Cluster.choose_node/2`."
  @spec choose_branch_node!(term(), keyword()) :: node()
  def choose_branch_node!(key, rule) do
    if :ets.whereis(@table) == :undefined, do: raise(not_member_error())
    rule = %{on: List.wrap(rule[:on]), only: rule[:only] || false}

    Placement.choose_branch_node(list_members(), rule, key) ||
      raise Error.new(:no_node, "no node may run the branch of #{inspect(key, limit: 5)}",
              why: "no member matches #{inspect(rule.on)}",
              fix: "start a member that has such a label or device, or omit only:"
            )
  end

  @doc "Returns the error for a node that is not a member of a cluster."
  @spec not_member_error() :: Error.t()
  def not_member_error do
    Error.new(:no_cluster, "this node is not a member of a cluster",
      fix: "start it with Situ.Cluster.start_link(log: ...)"
    )
  end

  @doc """
  Reports to the runners of a part on all other nodes that this node has acquired or released its lease. Skips nodes
  that cannot receive immediately, since they also read the log.
  """
  @spec report_lease(part(), pos_integer() | :free) :: :ok
  def report_lease(part, seq) do
    message = {:"$gen_cast", {:lease, part, seq, Atom.to_string(node())}}
    for node <- Node.list(), do: :erlang.send({Agent, node}, message, [:nosuspend, :noconnect])
    :ok
  end

  @doc "Reports to all other members that this node has renewed its lease under the number `seq`."
  @spec report_node_lease(NodeLease.t(), pos_integer()) :: :ok
  def report_node_lease(reference, seq) do
    message = {:"$gen_cast", {:node_lease, reference, seq}}
    for node <- Node.list(), do: :erlang.send({Agent, node}, message, [:nosuspend, :noconnect])
    :ok
  end

  @doc "Sends the caller the publisher of a part, now and whenever it changes."
  @spec follow_publisher(pid(), part()) :: term()
  def follow_publisher(agent, part), do: send(agent, {:situ_cluster, :follow, part, self()})

  @doc "Sends the publisher of a part to a process that follows it."
  @spec send_publisher(pid(), part(), pid()) :: term()
  def send_publisher(pid, part, publisher),
    do: send(pid, {:situ_cluster, :publisher, part, publisher})
end

defmodule Situ.Cluster.Member do
  @moduledoc false
  # The requests of a part's runner, of its pipeline's inlets and of the balancer to the cluster's agent on their node.
  # None of them waits for the agent, so the agent may wait for them.
  #
  #   {:situ_cluster, :follow, part, pid}            an inlet wants to know where a part is published
  #   {:situ_cluster, :publisher, part, publisher}   there, now and whenever that changes

  alias Situ.Cluster.{Agent, Deployment, Placement, Vitals}

  @table __MODULE__

  @type part :: {deployment :: String.t(), part :: String.t()}

  @doc "A part is published here."
  @spec route(GenServer.server(), part(), pos_integer(), pid()) :: :ok
  def route(agent, part, epoch, publisher),
    do: GenServer.cast(agent, {:route, part, epoch, publisher, :tell})

  @doc "This process looks after a part on this node."
  @spec runs(GenServer.server(), part(), pid()) :: :ok
  def runs(agent, part, runner), do: GenServer.cast(agent, {:runs, part, runner})

  @doc "Makes the agent's table of members and deployments, which all processes of the node read."
  @spec create_table() :: :ok
  def create_table do
    :ets.new(@table, [:named_table, :protected, read_concurrency: true])
    put_all(%{})
    put_deployments([])
    :ok
  end

  @doc "Replaces the members and their labels in the table."
  @spec put_all(%{node() => [String.t()]}) :: true
  def put_all(members), do: :ets.insert(@table, {:members, members})

  @doc "Replaces the deployments in the table."
  @spec put_deployments([Deployment.t()]) :: true
  def put_deployments(deployments), do: :ets.insert(@table, {:deployments, deployments})

  @doc "Returns the deployments that this node knows."
  @spec deployments() :: [Deployment.t()]
  def deployments, do: lookup(:deployments)

  @doc "Returns whether this node is the first of the members."
  @spec first?() :: boolean()
  def first?, do: :members |> lookup() |> Map.keys() |> Enum.min(fn -> nil end) == node()

  defp lookup(key), do: :ets.lookup_element(@table, key, 2)

  @doc "Returns the members with the properties that rules of place look at."
  @spec all() :: Placement.members()
  def all do
    vitals = Vitals.all()

    Map.new(lookup(:members), fn {node, labels} ->
      {node, vitals |> Map.get(node, %{}) |> Map.put(:labels, labels) |> Placement.member()}
    end)
  end

  @doc "How much this node is preferred for a part (0: most), or `nil`."
  @spec rank(map(), String.t()) :: non_neg_integer() | nil
  def rank(rule, part), do: Placement.rank(all(), rule, part, node())

  @doc """
  Tells the runners of a part on all other nodes that this node has written its lease, or has given it back. Does not
  wait for a node that cannot receive at the moment: that node looks at the log.
  """
  @spec tell_lease(part(), pos_integer() | :free) :: :ok
  def tell_lease(part, seq) do
    message = {:"$gen_cast", {:lease, part, seq, Atom.to_string(node())}}
    for node <- Node.list(), do: :erlang.send({Agent, node}, message, [:nosuspend, :noconnect])
    :ok
  end

  @doc "Sends the caller the publisher of a part, now and whenever it changes."
  @spec follow(pid(), part()) :: term()
  def follow(agent, part), do: send(agent, {:situ_cluster, :follow, part, self()})

  @doc "Tells where it is."
  @spec tell(pid(), part(), pid()) :: term()
  def tell(pid, part, publisher), do: send(pid, {:situ_cluster, :publisher, part, publisher})
end

defmodule Situ.Cluster.Member do
  @moduledoc false
  # The requests of a part's runner and of its pipeline's inlets to the cluster's agent on their node.
  #
  #   {:situ_cluster, :follow, part, pid}            an inlet wants to know where a part is published
  #   {:situ_cluster, :publisher, part, publisher}   there, now and whenever that changes

  @type part :: {deployment :: String.t(), part :: String.t()}

  @doc "A part is published here."
  @spec route(GenServer.server(), part(), pos_integer(), pid()) :: :ok
  def route(agent, part, epoch, publisher),
    do: GenServer.cast(agent, {:route, part, epoch, publisher, :tell})

  @doc "This process looks after a part on this node."
  @spec runs(GenServer.server(), part(), pid()) :: :ok
  def runs(agent, part, runner), do: GenServer.cast(agent, {:runs, part, runner})

  @doc "How much this node is preferred for a part (0: most), or `nil`."
  @spec rank(GenServer.server(), map(), String.t()) :: non_neg_integer() | nil
  def rank(agent, rule, part), do: GenServer.call(agent, {:rank, rule, part}, :infinity)

  @doc "Sends the caller the publisher of a part, now and whenever it changes."
  @spec follow(pid(), part()) :: term()
  def follow(agent, part), do: send(agent, {:situ_cluster, :follow, part, self()})

  @doc "Tells where it is."
  @spec tell(pid(), part(), pid()) :: term()
  def tell(pid, part, publisher), do: send(pid, {:situ_cluster, :publisher, part, publisher})
end

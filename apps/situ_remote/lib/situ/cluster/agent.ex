defmodule Situ.Cluster.Agent do
  @moduledoc false
  # This node as a member of the cluster: who else is there, which deployments there are, where each part runs. Says
  # hello to every node that it sees; a part's runner (`Situ.Cluster.Runner`) is started for every part of every
  # deployment, on every node, and the lease says which of them runs it.
  use GenServer

  alias Situ.Cluster.{Assembly, Logs, Member, Placement, Runner, Vitals}

  require Logger

  @spread_ms 2_000
  @spread_times 5

  defstruct [
    :log,
    :supervisor,
    labels: [],
    members: %{},
    deployments: %{},
    plans: %{},
    runners: %{},
    routes: %{},
    followers: %{}
  ]

  @doc "Starts it under its own name: there is one on a node."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts), do: GenServer.start_link(__MODULE__, opts, name: __MODULE__)

  @spec deploy(GenServer.server(), Situ.Cluster.Deployment.t()) :: :ok | {:error, Situ.Error.t()}
  def deploy(agent \\ __MODULE__, deployment) do
    with :ok <- GenServer.call(agent, {:deploy, deployment}, 60_000) do
      others = Map.keys(info(agent).members) -- [node()]
      if others != [], do: spread(others, deployment, @spread_times), else: :ok
    end
  end

  # It is deployed when another node knows it too: this one may be lost the next moment.
  defp spread(others, deployment, 0) do
    Logger.warning("#{deployment.name}: none of #{inspect(others)} has taken note of it yet")
  end

  defp spread(others, deployment, left) do
    case GenServer.multi_call(others, __MODULE__, {:install, deployment}, @spread_ms) do
      {[_ | _], _} -> :ok
      {[], _} -> spread(others, deployment, left - 1)
    end
  end

  @doc "Takes a deployment away, on all nodes."
  @spec forget(GenServer.server(), String.t()) :: :ok
  def forget(agent \\ __MODULE__, name), do: GenServer.call(agent, {:forget, name}, 60_000)

  @doc "Members, deployments, and what runs here."
  @spec info(GenServer.server()) :: map()
  def info(agent \\ __MODULE__), do: GenServer.call(agent, :info, 30_000)

  @doc "The runners of this node for a deployment, by part."
  @spec runners(GenServer.server(), String.t(), timeout()) :: %{String.t() => pid()}
  def runners(agent \\ __MODULE__, name, timeout \\ 30_000),
    do: GenServer.call(agent, {:runners, name}, timeout)

  @doc "How a deployment is cut, as this node runs it."
  @spec plan(GenServer.server(), String.t()) :: Situ.Cluster.Plan.t() | nil
  def plan(agent \\ __MODULE__, name), do: GenServer.call(agent, {:plan, name}, 30_000)

  @doc "The members with what rules of place ask of them."
  @spec known(GenServer.server()) :: Placement.members()
  def known(agent \\ __MODULE__), do: GenServer.call(agent, :known, 30_000)

  @doc "The log."
  @spec log(GenServer.server()) :: Situ.Remote.Log.t()
  def log(agent \\ __MODULE__), do: GenServer.call(agent, :log)

  @impl true
  def init(opts) do
    :ok = :net_kernel.monitor_nodes(true)
    :ok = Logs.start()
    {:ok, _} = Vitals.start_link(opts[:devices] || [])
    for {module, arg} <- opts[:beside] || [], do: {:ok, _} = module.start_link(arg)
    {:ok, supervisor} = DynamicSupervisor.start_link(strategy: :one_for_one, max_restarts: 100)
    state = %__MODULE__{log: opts[:log], labels: opts[:labels], supervisor: supervisor}
    for node <- Node.list(), do: hello(state, node, true)
    {:ok, %{state | members: %{node() => opts[:labels]}}}
  end

  defp hello(state, node, answer?) do
    own = for {part, {epoch, pid}} <- state.routes, node(pid) == node(), do: {part, epoch, pid}
    message = {:hello, node(), state.labels, Map.values(state.deployments), own, answer?}
    GenServer.cast({__MODULE__, node}, message)
  end

  @impl true
  def handle_call({:deploy, deployment}, _from, state) do
    with :ok <- free(state, deployment), {:ok, state} <- install(state, deployment) do
      others(state, {:install, deployment})
      {:reply, :ok, state}
    else
      {:error, error} -> {:reply, {:error, error}, state}
    end
  end

  def handle_call({:install, deployment}, _from, state),
    do: {:reply, :ok, installed(state, deployment)}

  def handle_call({:forget, name}, _from, state) do
    others(state, {:forget, name})
    {:reply, :ok, remove(state, name)}
  end

  def handle_call({:rank, rule, part}, _from, state),
    do: {:reply, Placement.rank(members(state), rule, part, node()), state}

  def handle_call({:plan, name}, _from, state), do: {:reply, state.plans[name], state}
  def handle_call(:known, _from, state), do: {:reply, members(state), state}

  def handle_call({:runners, name}, _from, state) do
    {:reply, for({{^name, part}, pid} <- state.runners, into: %{}, do: {part, pid}), state}
  end

  def handle_call(:log, _from, state), do: {:reply, state.log, state}

  def handle_call(:info, _from, state) do
    routes =
      Map.new(state.routes, fn {part, {epoch, pid}} ->
        {part, %{epoch: epoch, node: node(pid)}}
      end)

    {:reply,
     %{
       node: node(),
       members: state.members,
       deployments: Map.values(state.deployments),
       routes: routes
     }, state}
  end

  defp members(state) do
    vitals = Vitals.all()

    Map.new(state.members, fn {node, labels} ->
      {node, vitals |> Map.get(node, %{}) |> Map.put(:labels, labels) |> Placement.member()}
    end)
  end

  defp free(state, deployment) do
    case state.deployments do
      %{^deployment => _} ->
        :ok

      deployments when is_map_key(deployments, deployment.name) ->
        {:error, taken(deployment.name)}

      _ ->
        :ok
    end
  end

  defp taken(name) do
    Situ.Error.new(:duplicate_name, "there is already a deployment #{inspect(name)}",
      fix: "give this one another name:, or stop that one"
    )
  end

  @impl true
  def handle_cast({:hello, node, labels, deployments, routes, answer?}, state) do
    if answer?, do: hello(state, node, false)
    state = %{state | members: Map.put(state.members, node, labels)}
    state = Enum.reduce(deployments, state, &installed(&2, &1))
    {:noreply, Enum.reduce(routes, state, fn {p, e, pid}, state -> routed(state, p, e, pid) end)}
  end

  def handle_cast({:install, deployment}, state), do: {:noreply, installed(state, deployment)}
  def handle_cast({:forget, name}, state), do: {:noreply, remove(state, name)}

  def handle_cast({:route, part, epoch, pid, how}, state) do
    if how == :tell, do: others(state, {:route, part, epoch, pid, :told})
    {:noreply, routed(state, part, epoch, pid)}
  end

  def handle_cast({:runs, part, runner}, state) when is_map_key(state.runners, part),
    do: {:noreply, put_in(state.runners[part], runner)}

  def handle_cast({:runs, _part, _runner}, state), do: {:noreply, state}

  # Reading a stream of a part: the process hears where it is published, now and whenever that changes.
  @impl true
  def handle_info({:situ_cluster, :follow, part, pid}, state) do
    Process.monitor(pid)
    with %{^part => {_, publisher}} <- state.routes, do: Member.tell(pid, part, publisher)
    {:noreply, %{state | followers: Map.update(state.followers, part, [pid], &[pid | &1])}}
  end

  def handle_info({:DOWN, _, :process, pid, _}, state) do
    followers = Map.new(state.followers, fn {part, pids} -> {part, List.delete(pids, pid)} end)
    {:noreply, %{state | followers: followers}}
  end

  def handle_info({:nodeup, node}, state) do
    hello(state, node, true)
    {:noreply, state}
  end

  def handle_info({:nodedown, node}, state) do
    for {_, runner} <- state.runners, do: Runner.down(runner, node)
    {:noreply, %{state | members: Map.delete(state.members, node)}}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp others(state, message) do
    for {node, _} <- state.members,
        node != node(),
        do: GenServer.cast({__MODULE__, node}, message)

    :ok
  end

  defp routed(state, part, epoch, pid) do
    case state.routes do
      %{^part => {newer, _}} when newer > epoch ->
        state

      _ ->
        for follower <- Map.get(state.followers, part, []), do: Member.tell(follower, part, pid)
        %{state | routes: Map.put(state.routes, part, {epoch, pid})}
    end
  end

  # One that this node cannot build (it lacks the module) it does not run.
  defp installed(state, deployment) do
    case install(state, deployment) do
      {:ok, state} ->
        state

      {:error, error} ->
        Logger.warning("#{deployment.name} cannot run on #{node()}: #{Exception.message(error)}")
        state
    end
  end

  defp install(state, %{name: name}) when is_map_key(state.deployments, name), do: {:ok, state}

  defp install(state, deployment) do
    with {:ok, plan} <- Assembly.plan(deployment) do
      runners =
        for {part, _} <- plan.parts, into: state.runners do
          args = %{
            log: state.log,
            deployment: deployment,
            part: part,
            plan: plan,
            agent: self()
          }

          {:ok, pid} = DynamicSupervisor.start_child(state.supervisor, {Runner, args})
          {{deployment.name, part}, pid}
        end

      deployments = Map.put(state.deployments, deployment.name, deployment)
      plans = Map.put(state.plans, deployment.name, plan)
      {:ok, %{state | runners: runners, deployments: deployments, plans: plans}}
    end
  end

  defp remove(state, name) do
    {gone, kept} = Enum.split_with(state.runners, fn {{of, _}, _} -> of == name end)
    for {_, pid} <- gone, do: DynamicSupervisor.terminate_child(state.supervisor, pid)
    runners = Map.new(kept)
    routes = Map.reject(state.routes, fn {{of, _}, _} -> of == name end)
    deployments = Map.delete(state.deployments, name)
    plans = Map.delete(state.plans, name)
    %{state | runners: runners, routes: routes, deployments: deployments, plans: plans}
  end
end

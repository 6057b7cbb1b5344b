defmodule Situ.Cluster.Agent do
  @moduledoc false
  # Represents this node in the cluster: knows the other members, the deployments, and the node that runs each part.
  # Sends a hello to every node it sees. Every node starts a runner (`Situ.Cluster.Runner`) for every part of every
  # deployment, and the lease decides which node runs the part.
  use GenServer

  alias Situ.Cluster.{
    PartStarter,
    DeploymentLoader,
    Deployments,
    LogLines,
    Member,
    Runner,
    Runners
  }

  alias Situ.Cluster.{NodeLease, NodeLeaseWatcher, Placement, SealedLog, NodeMetrics}

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

  @doc "Starts the agent under a registered name, since each node has only one."
  @spec start_link(keyword()) :: GenServer.on_start()
  def start_link(opts), do: GenServer.start_link(__MODULE__, opts, name: __MODULE__)

  @doc "Stores a deployment in the log and runs it. Returns the deployment with its run."
  @spec deploy(GenServer.server(), Situ.Cluster.Deployment.t()) ::
          {:ok, Situ.Cluster.Deployment.t()} | {:error, Situ.Error.t()}
  def deploy(agent \\ __MODULE__, deployment) do
    log = get_log(agent)

    with {:ok, _plan} <- PartStarter.build_plan(deployment),
         {:ok, deployment} <- Deployments.put(log, deployment),
         :ok <- install_or_forget(agent, log, deployment) do
      others = Map.keys(info(agent).members) -- [node()]
      if others != [], do: spread_deployment(others, deployment, @spread_times)
      {:ok, deployment}
    end
  end

  # A deployment that cannot run here must not come back after a restart.
  defp install_or_forget(agent, log, deployment) do
    result = GenServer.call(agent, {:deploy, deployment}, 60_000)

    with {:error, %{code: code}} when code != :duplicate_name <- result,
         do: Deployments.forget(log, deployment.name)

    result
  end

  # Another node must know the deployment before it counts as deployed, since this node may be lost at any moment.
  defp spread_deployment(others, deployment, 0) do
    Logger.warning(
      "#{deployment.name}: none of #{inspect(others)} has confirmed the deployment yet"
    )
  end

  defp spread_deployment(others, deployment, tries) do
    case GenServer.multi_call(others, __MODULE__, {:install, deployment}, @spread_ms) do
      {[_ | _], _} -> :ok
      {[], _} -> spread_deployment(others, deployment, tries - 1)
    end
  end

  @doc "Removes a deployment from all nodes."
  @spec forget_deployment(GenServer.server(), String.t()) :: :ok | {:error, Situ.Error.t()}
  def forget_deployment(agent \\ __MODULE__, name) do
    :ok = GenServer.call(agent, {:forget, name}, 60_000)
    Deployments.forget(get_log(agent), name)
  end

  @doc "Returns the members, the deployments, and the node that runs each part."
  @spec info(GenServer.server()) :: map()
  def info(agent \\ __MODULE__), do: GenServer.call(agent, :info, 30_000)

  @doc "Returns this node's runners of a deployment, by part."
  @spec list_runners(GenServer.server(), String.t(), timeout()) :: %{String.t() => pid()}
  def list_runners(agent \\ __MODULE__, name, timeout \\ 30_000),
    do: GenServer.call(agent, {:runners, name}, timeout)

  @doc "Returns the plan of a deployment as this node runs it."
  @spec find_plan(GenServer.server(), String.t()) :: Situ.Cluster.Plan.t() | nil
  def find_plan(agent \\ __MODULE__, name), do: GenServer.call(agent, {:plan, name}, 30_000)

  @doc "Returns the members with the properties that placement rules use."
  @spec list_members(GenServer.server()) :: Placement.members()
  def list_members(agent \\ __MODULE__), do: GenServer.call(agent, :known, 30_000)

  @doc "Returns the log."
  @spec get_log(GenServer.server()) :: Situ.Cluster.Log.t()
  def get_log(agent \\ __MODULE__), do: GenServer.call(agent, :log)

  @impl true
  def init(opts) do
    :ok = :net_kernel.monitor_nodes(true)
    :ok = LogLines.start_handler()
    :ok = Member.create_table()
    :ok = NodeLeaseWatcher.create_table()
    {:ok, _} = NodeLeaseWatcher.start_link(opts[:log])
    {:ok, _} = NodeLease.start_link({opts[:log], &NodeLease.report_renewal/2})
    {:ok, _} = NodeMetrics.start_link(opts[:devices] || [])
    for {module, arg} <- opts[:companions] || [], do: {:ok, _} = module.start_link(arg)
    {:ok, supervisor} = DynamicSupervisor.start_link(strategy: :one_for_one, max_restarts: 100)
    state = %__MODULE__{log: opts[:log], labels: opts[:labels], supervisor: supervisor}
    for node <- Node.list(), do: send_hello(state, node, true)
    state = put_members(state, %{node() => opts[:labels]})
    {:ok, _} = DeploymentLoader.start_link({state.log, self()})
    {:ok, state}
  end

  defp send_hello(state, node, answer?) do
    own_routes =
      for {part, {epoch, pid}} <- state.routes, node(pid) == node(), do: {part, epoch, pid}

    message = {:hello, node(), state.labels, Map.values(state.deployments), own_routes, answer?}
    GenServer.cast({__MODULE__, node}, message)
  end

  @impl true
  def handle_call({:deploy, deployment}, _from, state) do
    with :ok <- check_name(state, deployment),
         {:ok, state} <- install_deployment(state, deployment) do
      cast_to_others(state, {:install, deployment})
      {:reply, :ok, state}
    else
      {:error, error} -> {:reply, {:error, error}, state}
    end
  end

  def handle_call({:install, deployment}, _from, state),
    do: {:reply, :ok, install_or_warn(state, deployment)}

  def handle_call({:forget, name}, from, state) do
    cast_to_others(state, {:forget, name})
    {:noreply, remove_deployment(state, name, fn -> GenServer.reply(from, :ok) end)}
  end

  def handle_call({:plan, name}, _from, state), do: {:reply, state.plans[name], state}
  def handle_call(:known, _from, state), do: {:reply, Member.list_members(), state}

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

  defp put_members(state, members) do
    Member.put_members(members)
    %{state | members: members}
  end

  defp put_deployments(state, deployments) do
    Member.put_deployments(Map.values(deployments))
    %{state | deployments: deployments}
  end

  defp check_name(%{deployments: deployments}, %{name: name} = deployment) do
    case deployments do
      %{^name => ^deployment} -> :ok
      %{^name => _another} -> {:error, Deployments.duplicate_error(name)}
      %{} -> :ok
    end
  end

  @impl true
  def handle_cast({:hello, node, labels, deployments, routes, answer?}, state) do
    if answer?, do: send_hello(state, node, false)
    state = put_members(state, Map.put(state.members, node, labels))
    state = Enum.reduce(deployments, state, &install_or_warn(&2, &1))

    {:noreply,
     Enum.reduce(routes, state, fn {p, e, pid}, state -> put_route(state, p, e, pid) end)}
  end

  def handle_cast({:install, deployment}, state),
    do: {:noreply, install_or_warn(state, deployment)}

  def handle_cast({:forget, name}, state),
    do: {:noreply, remove_deployment(state, name, fn -> :ok end)}

  def handle_cast({:route, part, epoch, pid, mode}, state) do
    if mode == :tell, do: cast_to_others(state, {:route, part, epoch, pid, :told})
    {:noreply, put_route(state, part, epoch, pid)}
  end

  # The supervisor has restarted a runner. Its part may have been forgotten, or may already have another runner.
  def handle_cast({:runs, part, runner}, state) do
    current = state.runners[part]

    cond do
      current == runner ->
        {:noreply, state}

      current != nil and not Process.alive?(current) ->
        {:noreply, put_in(state.runners[part], runner)}

      true ->
        Runner.dismiss(runner)
        {:noreply, state}
    end
  end

  def handle_cast({:lease, part, seq, owner}, state) do
    with %{^part => runner} <- state.runners, do: send(runner, {:situ_lease, seq, owner})
    {:noreply, state}
  end

  def handle_cast({:node_lease, reference, seq}, state) do
    :ok = NodeLeaseWatcher.note_renewal(reference, seq)
    {:noreply, state}
  end

  # The process wants to read a stream of the part, so it receives the current publisher and every later one.
  @impl true
  def handle_info({:situ_cluster, :follow, part, pid}, state) do
    Process.monitor(pid)

    with %{^part => {_, publisher}} <- state.routes,
         do: Member.send_publisher(pid, part, publisher)

    {:noreply, %{state | followers: Map.update(state.followers, part, [pid], &[pid | &1])}}
  end

  def handle_info({:DOWN, _, :process, pid, _}, state) do
    followers = Map.new(state.followers, fn {part, pids} -> {part, List.delete(pids, pid)} end)
    {:noreply, %{state | followers: followers}}
  end

  def handle_info({:nodeup, node}, state) do
    send_hello(state, node, true)
    {:noreply, state}
  end

  def handle_info({:nodedown, node}, state) do
    if is_map_key(state.members, node),
      do: Logger.warning("the node #{node} is lost: other nodes take over its parts")

    for {_, runner} <- state.runners, do: Runner.report_node_down(runner, node)
    {:noreply, put_members(state, Map.delete(state.members, node))}
  end

  def handle_info(_other, state), do: {:noreply, state}

  defp cast_to_others(state, message) do
    for {node, _} <- state.members,
        node != node(),
        do: GenServer.cast({__MODULE__, node}, message)

    :ok
  end

  defp put_route(state, part, epoch, pid) do
    case state.routes do
      %{^part => {newer, _}} when newer > epoch ->
        state

      _ ->
        for follower <- Map.get(state.followers, part, []),
            do: Member.send_publisher(follower, part, pid)

        %{state | routes: Map.put(state.routes, part, {epoch, pid})}
    end
  end

  # A deployment that this node cannot build (the module is missing) does not run here.
  defp install_or_warn(state, deployment) do
    case install_deployment(state, deployment) do
      {:ok, state} ->
        state

      {:error, error} ->
        Logger.warning("#{deployment.name} cannot run on #{node()}: #{Exception.message(error)}")
        state
    end
  end

  defp install_deployment(state, %{name: name}) when is_map_key(state.deployments, name),
    do: {:ok, state}

  defp install_deployment(state, deployment) do
    with {:ok, plan} <- PartStarter.build_plan(deployment) do
      runners =
        for {part, _} <- plan.parts, into: state.runners do
          args = %{
            log: SealedLog.new(state.log, deployment.run),
            deployment: deployment,
            part: part,
            plan: plan,
            agent: self()
          }

          {:ok, pid} = DynamicSupervisor.start_child(state.supervisor, {Runner, args})
          {{deployment.name, part}, pid}
        end

      state = put_deployments(state, Map.put(state.deployments, deployment.name, deployment))
      plans = Map.put(state.plans, deployment.name, plan)
      {:ok, %{state | runners: runners, plans: plans}}
    end
  end

  # A runner may end slowly, so a task waits for the runners and calls `on_done`.
  defp remove_deployment(state, name, on_done) do
    {removed, remaining} = Enum.split_with(state.runners, fn {{owner, _}, _} -> owner == name end)
    pids = for {_, pid} <- removed, do: pid

    {:ok, _} =
      Task.start_link(fn ->
        :ok = Runners.dismiss_all(pids)
        on_done.()
      end)

    runners = Map.new(remaining)
    routes = Map.reject(state.routes, fn {{owner, _}, _} -> owner == name end)
    state = put_deployments(state, Map.delete(state.deployments, name))
    plans = Map.delete(state.plans, name)
    %{state | runners: runners, routes: routes, plans: plans}
  end
end

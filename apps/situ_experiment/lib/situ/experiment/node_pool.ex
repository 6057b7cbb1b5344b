defmodule Situ.Experiment.NodePool do
  @moduledoc false
  # The nodes of a cluster that compute the trials of a run. All functions run in the runner's process.
  #
  #     runner (pool) ── monitors ──> NodeHost, one for each node
  #       └── a task for each running trial: asks a host, copies the output, writes the result
  #
  # Only these tasks write results, so a trial whose node is lost is computed by another node and counts once. Nodes
  # that join the cluster during the run take part, and so does a node that was lost and is back.
  # See docs/adr/0184-nodes-of-a-cluster-compute-trials.md.
  alias Situ.Dataset.StoreVersion
  alias Situ.Error

  alias Situ.Experiment.{
    CodeVersion,
    Context,
    FileTransfer,
    JobQueue,
    NodeHost,
    Provenance,
    RecordingCache,
    ResultsFile,
    Trial
  }

  @enforce_keys [:context, :setup, :list_nodes, :jobs, :notify]
  defstruct [
    :context,
    :setup,
    :list_nodes,
    :jobs,
    :notify,
    hosts: %{},
    refused: %{},
    machines: %{}
  ]

  @typedoc """
  `hosts`: the node of each host, and its folder there. `refused`: the nodes that cannot take part, with their errors.
  `machines`: all nodes that have taken part. `jobs`: the number of trials at the same time on each node.
  """
  @type t :: %__MODULE__{
          context: Context.t(),
          setup: NodeHost.setup(),
          list_nodes: (() -> [node()]),
          jobs: pos_integer(),
          notify: (String.t() -> term()),
          hosts: %{pid() => %{node: node(), folder: Path.t()}},
          refused: %{node() => Error.t()},
          machines: %{String.t() => map()}
        }

  @start_ms 180_000
  @poll_ms 5_000
  @lost_ms 2_000
  # A trial that ends so many nodes (memory, a crash of native code) would end all others, too.
  @most_losses 3

  @doc """
  Connects the nodes that `nodes:` of the options returns, and gives them the code of the experiment. `notify:` gets a
  sentence for each node that joins, is refused or is lost. If no node remains, the first reason is the error.
  """
  @spec connect(Context.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def connect(%Context{} = context, opts) do
    pool = %__MODULE__{
      context: context,
      setup: build_setup(context),
      list_nodes: opts[:nodes],
      jobs: opts[:jobs],
      notify: opts[:notify] || fn _ -> :ok end
    }

    case add_nodes(pool) do
      %{hosts: hosts} = pool when hosts != %{} -> {:ok, pool}
      pool -> {:error, no_node_error(pool)}
    end
  end

  defp build_setup(%Context{module: module, code: code} = context) do
    parts = CodeVersion.list_parts(code, module, [:build, :metrics], module.parameters())

    %{
      pool: self(),
      module: module,
      binaries: code.binaries,
      parts: parts,
      versions: Provenance.list_versions(),
      apps: for({app, _, _} <- Application.started_applications(), do: app),
      peer: %{node: node(), folder: context.folder}
    }
  end

  defp no_node_error(%{refused: refused}) do
    case Map.values(refused) do
      [error | _] ->
        error

      [] ->
        Error.new(:no_node, "no node of the cluster can compute the experiment",
          why: "the cluster has no such node, or all of them were lost",
          fix: "start nodes with `situ cluster join`; the same command continues the run"
        )
    end
  end

  defp add_nodes(pool) do
    known = for({_, %{node: node}} <- pool.hosts, do: node) ++ Map.keys(pool.refused)
    new = Enum.uniq(pool.list_nodes.()) -- known

    new
    |> Task.async_stream(&{&1, start_host(&1, pool.setup)}, timeout: :infinity)
    |> Enum.reduce(pool, fn {:ok, {node, started}}, pool -> add_host(pool, node, started) end)
  end

  defp start_host(node, setup) do
    :erpc.call(node, NodeHost, :start, [setup], @start_ms)
  catch
    :error, {:exception, :undef, _} -> {:error, missing_error(node)}
    _, reason -> {:error, unreachable_error(node, reason)}
  end

  defp missing_error(node) do
    Error.new(:other_version, "#{node} does not have situ_experiment of this version",
      fix: "install the same release on all machines, and start the nodes again"
    )
  end

  defp unreachable_error(node, reason) do
    Error.new(:unreachable, "#{node} is not responding",
      why: inspect(reason, limit: 5),
      fix: "check the node and its connection"
    )
  end

  defp add_host(pool, node, {:ok, {host, folder, machine}}) do
    Process.monitor(host)
    pool.notify.("#{node} takes part")
    hosts = Map.put(pool.hosts, host, %{node: node, folder: folder})
    %{pool | hosts: hosts, machines: Map.put(pool.machines, to_string(node), machine)}
  end

  defp add_host(pool, node, {:error, error}) do
    pool.notify.("#{node} does not take part: #{Exception.message(error)}")
    %{pool | refused: Map.put(pool.refused, node, error)}
  end

  @doc """
  Computes trials and calls `fun` with each trial, its result and an accumulator. Raises an error if no node is left, or
  if a result cannot be written.
  """
  @spec compute_trials(t(), [{Trial.t(), stamps :: map()}], acc, (Trial.t(), map(), acc -> acc)) ::
          {t(), acc}
        when acc: term()
  def compute_trials(pool, trials, acc, fun) do
    jobs =
      for {trial, stamps} <- trials,
          do: {trial.session.name, %{trial: trial, stamps: stamps, losses: 0}}

    run_loop(%{
      pool: pool,
      queue: JobQueue.new(jobs),
      left: length(jobs),
      running: %{},
      polled: now_ms(),
      acc: acc,
      fun: fun
    })
  end

  defp run_loop(%{left: 0} = state), do: {state.pool, state.acc}

  defp run_loop(state) do
    state = state |> poll_nodes() |> start_jobs()

    if state.running == %{},
      do: raise(no_node_error(state.pool)),
      else: state |> await_event() |> run_loop()
  end

  defp poll_nodes(state) do
    if state.pool.hosts == %{} or now_ms() - state.polled > @poll_ms,
      do: %{state | pool: add_nodes(state.pool), polled: now_ms()},
      else: state
  end

  defp now_ms, do: System.monotonic_time(:millisecond)

  defp await_event(state) do
    receive do
      {ref, outcome} when is_map_key(state.running, ref) ->
        Process.demonitor(ref, [:flush])
        {{job, host}, state} = pop_in(state.running[ref])
        put_outcome(state, outcome, job, host)

      {:DOWN, _, :process, host, _} when is_map_key(state.pool.hosts, host) ->
        drop_host(state, host, "was lost; other nodes compute its trials")
    after
      @poll_ms -> state
    end
  end

  # Every node gets a job before any gets a second one.
  defp start_jobs(state) do
    busy = Enum.frequencies_by(state.running, fn {_, {_, host}} -> host end)

    free =
      for {host, _} <- state.pool.hosts,
          count = Map.get(busy, host, 0),
          count < state.pool.jobs,
          do: {count, host}

    with {_, host} <- Enum.min(free, fn -> nil end),
         {{:ok, job}, queue} <- JobQueue.take(state.queue, state.pool.hosts[host].node) do
      start_jobs(start_job(%{state | queue: queue}, job, host))
    else
      _ -> state
    end
  end

  defp start_job(%{pool: pool} = state, job, host) do
    task = Task.async(fn -> compute_remotely(job, {host, pool.hosts[host]}, pool.context) end)
    put_in(state.running[task.ref], {job, host})
  end

  defp compute_remotely(%{trial: trial, stamps: stamps}, {host, at}, context) do
    monitor = Process.monitor(host)
    tag = make_ref()
    inputs = RecordingCache.describe_inputs(trial.session, stamps)
    NodeHost.request_job(host, %{trial: trial, inputs: inputs}, tag)

    with {:ok, result} <- await_result(tag, monitor),
         {:ok, result} <- take_output(result, {host, at, monitor}, context) do
      result = Map.put(result, "node", to_string(at.node))
      with :ok <- ResultsFile.append_result(context.folder, result), do: {:ok, result}
    end
  end

  defp await_result(tag, monitor) do
    receive do
      {^tag, {:ok, result}} -> {:ok, result}
      {^tag, {:error, error}} -> {:refused, error}
      {:DOWN, ^monitor, _, _, _} -> :lost
    end
  end

  defp take_output(%{"output" => output} = result, {host, at, monitor}, context) do
    path = Path.join([context.folder, "outputs", result["key"]])
    draft = StoreVersion.draft_path(path)

    with :ok <- FileTransfer.fetch_folder(at.node, Path.join(at.folder, output), draft),
         {:ok, output} <- StoreVersion.publish_draft(draft, path) do
      NodeHost.delete_output(host, result["output"])
      {:ok, %{result | "output" => Path.relative_to(output, context.folder)}}
    else
      {:error, error} ->
        StoreVersion.discard_draft(draft)
        explain_failure(error, monitor)
    end
  end

  defp take_output(result, _host, _context), do: {:ok, result}

  # The files of a lost node cannot be copied, and its loss is reported soon afterwards.
  defp explain_failure(error, monitor) do
    receive do
      {:DOWN, ^monitor, _, _, _} -> :lost
    after
      @lost_ms -> {:error, error}
    end
  end

  defp put_outcome(state, {:ok, result}, job, _host), do: put_result(state, job, result)
  defp put_outcome(_state, {:error, error}, _job, _host), do: raise(error)

  defp put_outcome(state, {:refused, error}, job, host) do
    node = state.pool.hosts[host] && state.pool.hosts[host].node
    state = drop_host(state, host, "does not take part any longer: #{Exception.message(error)}")
    NodeHost.stop(host)
    state = if node, do: put_in(state.pool.refused[node], error), else: state
    put_back(state, job)
  end

  defp put_outcome(state, :lost, %{losses: losses} = job, host) do
    state = drop_host(state, host, "was lost; other nodes compute its trials")

    if losses + 1 < @most_losses,
      do: put_back(state, %{job | losses: losses + 1}),
      else: put_result(state, job, write_failure!(job.trial, state.pool.context))
  end

  defp put_back(state, job),
    do: %{state | queue: JobQueue.put_back(state.queue, job.trial.session.name, job)}

  defp put_result(state, job, result),
    do: %{state | acc: state.fun.(job.trial, result, state.acc), left: state.left - 1}

  defp write_failure!(trial, context) do
    error =
      Error.new(:node_lost, "#{@most_losses} nodes were lost while they computed this trial",
        fix: "run it without --cluster, and look at its memory"
      )

    result = Trial.describe_failure(trial, context, error)
    Error.unwrap!(ResultsFile.append_result(context.folder, result))
    result
  end

  defp drop_host(%{pool: pool} = state, host, why) do
    case Map.pop(pool.hosts, host) do
      {nil, _} ->
        state

      {%{node: node}, hosts} ->
        pool.notify.("#{node} #{why}")
        %{state | pool: %{pool | hosts: hosts}, queue: JobQueue.forget_node(state.queue, node)}
    end
  end
end

defmodule Situ.Dataset.Derivation do
  @moduledoc false
  # Runs a pipeline over every session and passes each output to the caller, which adds it to its
  # dataset. `Situ.Dataset.derive/3` documents the pipeline, the options and the report.

  @options [
    output: [
      type: {:optional, :string},
      doc:
        "The new partition's name. Without it, the pipeline runs only for its effects and its result."
    ],
    overwrite: [
      type: :boolean,
      default: false,
      doc: "Replace an existing partition of that name; the old recording is not deleted."
    ],
    store: [type: :string, doc: "The new store's name. Default: the name of the output."],
    path: [
      type: {:or, [:string, {:fun, 1}]},
      doc:
        "The store's folder, or a function of the session. Default: the folder of the session's first partition."
    ],
    sessions: [type: {:list, :string}, doc: "Run only these sessions."],
    options: [type: :keyword, default: [], doc: "Options for a module's `build/2`."],
    pipeline: [
      type: :keyword,
      default: [],
      doc: "Settings of each pipeline (`Situ.Pipeline`). Default: all data, as fast as possible."
    ],
    parallel: [type: :pos_integer, default: 1, doc: "Number of concurrent sessions on each node."],
    nodes: [
      type: {:list, :atom},
      doc: "Cluster nodes that share these files. Default: this node."
    ],
    on_failure: [
      type: {:in, [:continue, :stop]},
      default: :continue,
      doc: "Whether the other sessions continue if one fails."
    ],
    resume: [
      type: :boolean,
      default: true,
      doc: "Keep the results of an earlier, interrupted run of the same output."
    ],
    provenance: [
      type: {:fun, 1},
      doc:
        "A function of the session that returns a map for JSON, which says how its output is made. It is called " <>
          "before the session starts, and stored as `extra[\"provenance\"]` of the new partition."
    ],
    progress: [
      type: {:fun, 1},
      doc: "Called with the progress at most ten times a second."
    ],
    cancel: [type: {:fun, 0}, doc: "Called ten times a second; `true` cancels the run."]
  ]

  alias Situ.Dataset.Derivation.{Job, RunJournal, Progress, Report}
  alias Situ.Dataset.{Partition, Session, Summary}
  alias Situ.{Error, Options}

  @tick_ms 100

  @typedoc "Adds a finished partition to the dataset, which this module does not know."
  @type commit ::
          (acc :: term(), Session.t(), Partition.t() ->
             {:ok, acc :: term()} | {:error, Error.t()})

  @doc false
  def options, do: @options

  @doc """
  Runs `compute` over `sessions`; `commit` adds each result to `acc`. `file` is the dataset's file or `nil`.
  """
  @spec run([Session.t()], Job.compute(), Path.t() | nil, {term(), commit()}, keyword()) ::
          {:ok, acc :: term(), Report.t()} | {:error, Error.t()}
  def run(sessions, compute, file, {acc, commit}, opts) do
    with {:ok, opts} <- Options.validate(opts, @options),
         {log, done} =
           RunJournal.open(file, opts[:output], Keyword.take(opts, [:resume, :overwrite])),
         {:ok, acc, kept_names} <- recover_results(sessions, done, acc, commit, opts),
         :ok <- check_output_free(sessions, kept_names, opts) do
      waiting = Enum.reject(sessions, &(&1.name in kept_names))

      state = %{
        acc: acc,
        commit: commit,
        log: log,
        opts: opts,
        compute: compute,
        waiting: waiting,
        running: %{},
        slots: node_slots(opts),
        results:
          Enum.map(kept_names, &%{session: &1, status: :kept, error: nil, result: nil, took: 0}),
        progress: Progress.new(session_weights(sessions), kept_names),
        cancelled?: false
      }

      run_coordinator(state, Enum.map(sessions, & &1.name))
    end
  end

  # Runs in a separate process, so that the pipelines end with it and their messages do not reach the caller.
  defp run_coordinator(state, order) do
    started = System.monotonic_time()

    state =
      Task.async(fn ->
        Process.flag(:trap_exit, true)
        state |> start_sessions() |> await_sessions()
      end)
      |> Task.await(:infinity)

    failed? = Enum.any?(state.results, &(&1.status == :failed))

    if state.cancelled? or failed?,
      do: RunJournal.record_end(state.log),
      else: RunJournal.remove(state.log)

    {:ok, state.acc,
     %Report{
       output: state.opts[:output],
       results: Enum.sort_by(state.results, &Enum.find_index(order, fn n -> n == &1.session end)),
       cancelled?: state.cancelled?,
       duration: System.convert_time_unit(System.monotonic_time() - started, :native, :nanosecond)
     }}
  end

  # Adds the outputs that were complete when a run was killed, because they may not be in the dataset yet.
  defp recover_results(sessions, done, acc, commit, opts) do
    sessions
    |> Enum.filter(&(is_map_key(done, &1.name) and File.dir?(elem(done[&1.name], 0))))
    |> Enum.reduce_while({:ok, acc, []}, fn session, {:ok, acc, kept_names} ->
      {folder, provenance} = done[session.name]
      partition = Job.build_partition(opts[:output], folder, provenance)

      case commit.(acc, session, partition) do
        {:ok, acc} -> {:cont, {:ok, acc, [session.name | kept_names]}}
        {:error, error} -> {:halt, {:error, error}}
      end
    end)
  end

  defp check_output_free(sessions, kept_names, opts) do
    name = opts[:output]

    conflicts =
      for s <- sessions,
          s.name not in kept_names,
          Enum.any?(s.partitions, &(&1.name == name)),
          do: s.name

    if conflicts == [] or opts[:overwrite] do
      :ok
    else
      {:error,
       Error.new(
         :partition_exists,
         "#{length(conflicts)} sessions already have a partition #{inspect(name)}",
         why: "the first is #{inspect(hd(conflicts))}",
         fix: "choose another output, or pass overwrite: true"
       )}
    end
  end

  defp node_slots(opts) do
    nodes = opts[:nodes] || [node()]
    for _ <- 1..opts[:parallel], node <- nodes, do: node
  end

  # Sessions are weighted by their duration.
  defp session_weights(sessions) do
    for session <- sessions do
      {session.name, session |> Session.summary() |> Summary.duration() |> max(1)}
    end
  end

  defp start_sessions(%{waiting: [], slots: _} = state), do: state
  defp start_sessions(%{slots: []} = state), do: state

  defp start_sessions(%{waiting: [session | waiting], slots: [node | slots]} = state) do
    job = Job.new(session, state.compute, state.opts)
    state = %{state | waiting: waiting, slots: slots}

    case RunJournal.record_start(state.log, session.name, job.draft) do
      :ok ->
        pid = Node.spawn_link(node, Job, :run, [job, self()])
        running = %{job: job, node: node, pipeline: nil, began: System.monotonic_time()}
        start_sessions(%{state | running: Map.put(state.running, pid, running)})

      {:error, error} ->
        start_sessions(
          record_result(%{state | slots: [node | slots]}, session.name, :failed, error, nil, 0)
        )
    end
  end

  defp await_sessions(%{running: running, waiting: []} = state) when running == %{}, do: state

  defp await_sessions(%{running: running, cancelled?: true} = state) when running == %{},
    do: state

  defp await_sessions(state) do
    receive do
      {:pipeline, pid, pipeline} when is_map_key(state.running, pid) ->
        await_sessions(put_in(state.running[pid].pipeline, pipeline))

      {:EXIT, pid, reason} when is_map_key(state.running, pid) ->
        state |> handle_session_end(pid, reason) |> start_sessions() |> await_sessions()

      {:EXIT, _caller, reason} when reason != :normal ->
        exit(reason)
    after
      @tick_ms -> state |> report_progress() |> await_sessions()
    end
  end

  defp report_progress(state) do
    fractions =
      for {_, r} <- state.running,
          do: {r.job.session.name, Progress.pipeline_fraction(r.pipeline)}

    progress = Progress.update_running(state.progress, fractions)
    if fun = state.opts[:progress], do: fun.(progress)
    state = %{state | progress: progress}
    if not state.cancelled? and cancel_requested?(state), do: cancel_run(state), else: state
  end

  defp cancel_requested?(state), do: state.opts[:cancel] != nil and state.opts[:cancel].() == true

  # Each pipeline ends with the process that runs it.
  defp cancel_run(state) do
    for {pid, _} <- state.running, do: Process.exit(pid, :kill)
    %{state | cancelled?: true, waiting: []}
  end

  defp handle_session_end(state, pid, reason) do
    {%{job: job, node: node, began: start} = running, others} = Map.pop(state.running, pid)
    took = System.convert_time_unit(System.monotonic_time() - start, :native, :nanosecond)
    state = %{state | running: others, slots: [node | state.slots]}

    case exit_outcome(reason, state) do
      {:done, result} ->
        publish_session(state, job, result, took)

      {status, error} ->
        state
        |> discard_session(running)
        |> record_result(job.session.name, status, error, nil, took)
    end
  end

  defp exit_outcome({:shutdown, {:done, result}}, _state), do: {:done, result}
  defp exit_outcome({:shutdown, {:failed, error}}, _state), do: {:failed, error}
  defp exit_outcome(:killed, %{cancelled?: true}), do: {:cancelled, nil}

  defp exit_outcome(reason, _state) do
    {:failed,
     Error.new(:session_crashed, "the process of the session crashed",
       why: inspect(reason, limit: 10),
       fix: "see the log; the other sessions are not affected"
     )}
  end

  # A pipeline whose owner was killed still closes its store, so the folder is deleted after the pipeline has ended.
  defp discard_session(state, %{job: job, pipeline: pipeline}) do
    if pipeline, do: await_exit(pipeline.pid)
    Job.discard_output(job)
    state
  end

  defp await_exit(pid) do
    monitor = Process.monitor(pid)

    receive do
      {:DOWN, ^monitor, _, _, _} -> :ok
    after
      30_000 -> Process.demonitor(monitor, [:flush])
    end
  end

  defp publish_session(state, %{draft: nil} = job, result, took),
    do: record_result(state, job.session.name, :done, nil, result, took)

  defp publish_session(state, job, result, took) do
    with {:ok, folder} <- Job.publish_output(job),
         :ok <- RunJournal.record_done(state.log, job.session.name, {folder, job.provenance}),
         partition = Job.build_partition(state.opts[:output], folder, job.provenance),
         {:ok, acc} <- state.commit.(state.acc, job.session, partition) do
      record_result(%{state | acc: acc}, job.session.name, :done, nil, result, took)
    else
      {:error, error} -> record_result(state, job.session.name, :failed, error, nil, took)
    end
  end

  defp record_result(state, name, status, error, result, took) do
    entry = %{session: name, status: status, error: error, result: result, took: took}
    progress = Progress.finish_session(state.progress, name)
    state = %{state | results: [entry | state.results], progress: progress}
    if fun = state.opts[:progress], do: fun.(progress)
    if status == :failed and state.opts[:on_failure] == :stop, do: cancel_run(state), else: state
  end
end

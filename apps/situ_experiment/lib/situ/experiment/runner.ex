defmodule Situ.Experiment.Runner do
  @moduledoc false
  # Runs an experiment over a dataset: plans the trials, keeps the results that exist, and computes the others.
  #
  #     caller ── coordinator (owns the tables)
  #                 └── a task for each running trial, with its pipeline
  #
  # Every task is linked to the coordinator, so a cancelled run ends all pipelines. Results that were written remain.
  alias Situ.{Dataset, Error, Metric, Options}
  alias Situ.Dataset.StoreVersion

  alias Situ.Experiment.{
    CodeVersion,
    Context,
    InputStamp,
    NodePool,
    Plan,
    Provenance,
    ResultsFile,
    RunRecord,
    Search,
    Trial
  }

  alias Situ.Metric.{Measurement, StoredMetric}

  @options [
    sessions: [type: {:fun, 1}, doc: "A function that returns whether a session takes part."],
    jobs: [type: :pos_integer, default: 1, doc: "Number of concurrent trials, on each node."],
    nodes: [type: {:fun, 0}, doc: "Returns the connected nodes that compute the trials."],
    notify: [
      type: {:fun, 1},
      doc: "Called with a sentence when a node joins, is refused or is lost."
    ],
    method: [type: {:in, [:grid, :random, :halving]}, default: :grid, doc: "The search."],
    trials: [type: :pos_integer, default: 20, doc: "`:random`: the number of sets."],
    seed: [type: :integer, default: 1, doc: "The seed of all random choices."],
    only: [type: :map, doc: "Run only the set with these parameters, in their JSON form."],
    file: [type: {:optional, :string}, doc: "The file of the experiment."],
    binaries: [type: :map, default: %{}, doc: "The modules that were compiled from this file."],
    progress: [type: {:fun, 1}, doc: "Called after every trial."]
  ]

  @type progress :: %{
          done: non_neg_integer(),
          total: pos_integer(),
          computed: non_neg_integer(),
          failed: non_neg_integer(),
          left_s: float() | nil,
          last: map()
        }

  @doc false
  def options, do: @options

  @doc "Runs `module` over the dataset and returns the folder and the record of the run."
  @spec run(module(), Dataset.t(), keyword()) :: {:ok, {Path.t(), map()}} | {:error, Error.t()}
  def run(module, %Dataset{} = dataset, opts \\ []) do
    with {:ok, opts} <- Options.validate(opts, @options),
         {:ok, plan} <- Plan.new(module, dataset, opts),
         do: Task.await(Task.async(fn -> try_plan(plan) end), :infinity)
  end

  # A full disk ends the run; the results so far remain.
  defp try_plan(plan) do
    run_plan(plan)
  rescue
    error in Error -> {:error, error}
  end

  defp run_plan(plan) do
    code = CodeVersion.new(plan.opts[:binaries])
    context = %Context{module: plan.module, folder: plan.folder, code: code}
    File.mkdir_p!(Path.join(plan.folder, "runs"))
    discard_drafts(plan.folder)

    stamps = Map.new(plan.sessions, &{&1.name, InputStamp.partition_stamps(&1)})
    run = new_run(plan, context, stamps)

    state = %{
      plan: plan,
      context: context,
      stamps: stamps,
      run: run,
      pool: nil,
      listed: MapSet.new(),
      results: ResultsFile.read_results(plan.folder),
      total: run["total"],
      done: 0,
      computed: 0,
      failed: 0,
      began: System.monotonic_time(:millisecond)
    }

    with {:ok, pool} <- connect_nodes(context, plan.opts),
         state = put_pool(state, pool),
         :ok <- RunRecord.write_run(plan.folder, state.run),
         run = plan.opts[:method] |> run_method(state) |> finish_run(),
         :ok <- RunRecord.write_run(plan.folder, run),
         do: {:ok, {plan.folder, run}}
  end

  defp put_pool(state, nil), do: state

  defp put_pool(state, pool),
    do: %{state | pool: pool, run: Map.put(state.run, "nodes", pool.machines)}

  defp connect_nodes(context, opts) do
    if opts[:nodes], do: NodePool.connect(context, opts), else: {:ok, nil}
  end

  # A killed run leaves unfinished recordings. Those of a process that is still running are kept.
  defp discard_drafts(folder) do
    for part <- ["outputs", "stages" | list_stages(folder)],
        draft <- ResultsFile.list_files(Path.join(folder, part), ".unfinished"),
        [_, pid] <- [Regex.run(~r/\.(\d+)-\d+\.unfinished\z/, draft)],
        not File.dir?("/proc/#{pid}"),
        do: StoreVersion.discard_draft(draft)
  end

  defp list_stages(folder) do
    for path <- ResultsFile.list_files(Path.join(folder, "stages"), ""),
        do: Path.relative_to(path, folder)
  end

  defp new_run(plan, context, stamps) do
    now = Situ.Time.now()

    %{
      "run" => RunRecord.new_name(plan.folder, now),
      "experiment" => plan.name,
      "module" => inspect(plan.module),
      "status" => "running",
      "pid" => System.pid(),
      "started" => Situ.Time.to_iso8601(now),
      "method" => if(plan.opts[:only], do: "check", else: to_string(plan.opts[:method])),
      "seed" => plan.opts[:seed],
      "metrics" => describe_metrics(plan.module),
      "parameters" => for({name, _} <- plan.module.parameters(), do: to_string(name)),
      "sets" => Enum.map(plan.sets, &describe_set/1),
      "sessions" => Enum.map(plan.sessions, & &1.name),
      "inputs" => stamps,
      "environment" => Provenance.describe_environment(context, plan.opts[:file]),
      "total" => count_trials(plan),
      "kept" => 0,
      "trials" => []
    }
  end

  defp describe_set(set) do
    %{
      "number" => set.number,
      "label" => set.label,
      "parameters" => set.json,
      "texts" => set.texts
    }
  end

  # The report needs no code of the experiment.
  defp describe_metrics(module) do
    for {name, metric} <- module.metrics(),
        do: StoredMetric.to_json(name, Measurement.wrap_function(metric))
  end

  defp count_trials(%{opts: opts, sets: sets, sessions: sessions}) do
    if opts[:method] == :halving do
      Enum.sum(for {m, n} <- Search.halving_rounds(length(sets), length(sessions)), do: m * n)
    else
      length(sets) * length(sessions)
    end
  end

  defp run_method(:halving, %{plan: plan} = state) do
    sessions = Search.shuffle(plan.sessions, plan.opts[:seed])

    {state, _} =
      length(plan.sets)
      |> Search.halving_rounds(length(sessions))
      |> Enum.reduce({state, plan.sets}, fn {count, n}, {state, sets} ->
        sets = if count == length(sets), do: sets, else: best_sets(state, sets, count)
        {run_trials(state, sets, Enum.take(sessions, n)), sets}
      end)

    state
  end

  defp run_method(_method, %{plan: plan} = state), do: run_trials(state, plan.sets, plan.sessions)

  defp best_sets(state, sets, count) do
    [{name, metric} | _] = state.plan.module.metrics()
    metric = Measurement.wrap_function(metric)

    scored =
      for set <- sets do
        counts =
          for %{"set" => number, "key" => key} <- state.listed,
              number == set.number,
              %{"measurements" => all} <- [state.results[key]],
              do: all[to_string(name)]["counts"]

        {set, Metric.summarize(metric, counts)[metric.main]}
      end

    Search.keep_best(scored, count, Metric.direction(metric, metric.main))
  end

  # All sets of a session run one after the other, because they share its stages.
  defp run_trials(state, sets, sessions) do
    trials =
      for session <- sessions, set <- sets do
        stamp = InputStamp.session_stamp(session, state.stamps[session.name])
        Trial.new(state.context, session, set, stamp)
      end

    {kept, waiting} = Enum.split_with(trials, &finished?(state.results[&1.key], &1))
    state = Enum.reduce(trials, state, &list_trial/2)
    state = update_in(state.run["kept"], &(&1 + length(kept)))
    Error.unwrap!(RunRecord.write_run(state.plan.folder, record_trials(state)))
    state = Enum.reduce(kept, state, &keep_result/2)
    compute_trials(state, waiting)
  end

  defp finished?(%{"status" => "done", "metrics" => metrics}, trial),
    do: metrics == trial.metrics_key

  defp finished?(_, _trial), do: false

  defp keep_result(trial, state) do
    state
    |> Map.update!(:done, &(&1 + 1))
    |> report_progress(state.results[trial.key])
  end

  # A measurement needs no pipeline, and its recording is here.
  defp compute_trials(%{pool: %NodePool{} = pool} = state, waiting) do
    {measured, waiting} =
      Enum.split_with(waiting, &output_exists?(state.results[&1.key], state.context))

    state = compute_here(state, measured)
    trials = for trial <- waiting, do: {trial, state.stamps[trial.session.name]}
    {pool, state} = NodePool.compute_trials(pool, trials, state, &put_result(&3, &1, &2))
    put_pool(state, pool)
  end

  defp compute_trials(state, waiting), do: compute_here(state, waiting)

  defp compute_here(%{context: context} = state, waiting) do
    known = state.results

    waiting
    |> Stream.transform(nil, &attach_session/2)
    |> Task.async_stream(&compute_result(&1, context, known[&1.key]),
      max_concurrency: state.plan.opts[:jobs],
      timeout: :infinity
    )
    |> Stream.zip(waiting)
    |> Enum.reduce(state, &put_outcome/2)
  end

  defp put_outcome({{:ok, outcome}, trial}, state),
    do: put_result(state, trial, Error.unwrap!(outcome))

  # The recordings of a session are opened once for all its sets.
  defp attach_session(trial, {session, _} = opened) when session == trial.session,
    do: {[%{trial | opened: elem(opened, 1)}], opened}

  defp attach_session(trial, _before) do
    opened = Trial.open_session(trial.session)
    {[%{trial | opened: opened}], {trial.session, opened}}
  end

  # A result is on disk before the task ends.
  defp compute_result(trial, context, known) do
    result =
      if output_exists?(known, context),
        do: Trial.measure_again(trial, context, known),
        else: Trial.run_trial(trial, context)

    with :ok <- ResultsFile.append_result(context.folder, result), do: {:ok, result}
  end

  defp output_exists?(%{"status" => "done", "output" => output}, context),
    do: File.dir?(Path.join(context.folder, output))

  defp output_exists?(_known, _context), do: false

  defp put_result(state, trial, result) do
    failed = if result["status"] == "failed", do: 1, else: 0

    %{
      state
      | results: Map.put(state.results, trial.key, result),
        done: state.done + 1,
        computed: state.computed + 1,
        failed: state.failed + failed
    }
    |> report_progress(result)
  end

  # A set may run over the same session in several rounds of a search.
  defp list_trial(trial, state) do
    entry = %{
      "set" => trial.set.number,
      "session" => trial.session.name,
      "key" => trial.key,
      "metrics" => trial.metrics_key
    }

    if entry in state.listed, do: state, else: %{state | listed: MapSet.put(state.listed, entry)}
  end

  defp record_trials(state) do
    Map.put(state.run, "trials", Enum.sort_by(state.listed, &{&1["set"], &1["session"]}))
  end

  defp report_progress(%{plan: %{opts: opts}} = state, last) do
    if fun = opts[:progress] do
      fun.(%{
        done: state.done,
        total: state.total,
        computed: state.computed,
        failed: state.failed,
        left_s: estimate_left(state),
        last: last
      })
    end

    state
  end

  defp estimate_left(%{computed: 0}), do: nil

  defp estimate_left(state) do
    spent = (System.monotonic_time(:millisecond) - state.began) / 1000
    spent / state.computed * max(state.total - state.done, 0)
  end

  defp finish_run(state) do
    Map.merge(record_trials(state), %{
      "status" => "finished",
      "ended" => Situ.Time.to_iso8601(Situ.Time.now()),
      "computed" => state.computed,
      "failed" => state.failed
    })
  end
end

defmodule Situ.Studio.Experiments do
  @moduledoc false
  # Reads the experiments over a dataset for their page: the runs, the sets of one run with their values, the baseline
  # that they are compared with, and the comments. All of it is in the files of the experiments, so a run in another
  # program is shown as well.
  # See docs/adr/0180-the-studio-shows-the-files-of-experiments.md.
  alias Situ.Experiment.{Baseline, Comments, Progress, ResultsFile, RunRecord, Summary}

  @enforce_keys [:runs]
  defstruct [:runs, :folder, :run, :status, :progress, :baseline, rows: [], comments: []]

  @typedoc """
  The set that others are compared with: promoted by somebody, or the best set until then. `number` is `nil` if the set
  is not in the shown run.
  """
  @type baseline :: %{
          folder: Path.t(),
          run: map(),
          set: pos_integer(),
          number: pos_integer() | nil,
          promoted?: boolean(),
          metrics: %{String.t() => %{String.t() => number() | nil}}
        }
  @type t :: %__MODULE__{
          runs: [%{name: String.t(), experiment: String.t(), status: String.t()}],
          folder: Path.t() | nil,
          run: map() | nil,
          status: String.t() | nil,
          progress: Progress.t() | nil,
          baseline: baseline() | nil,
          rows: [Summary.row()],
          comments: [Comments.comment()]
        }

  @doc "Returns whether a dataset has a folder of experiments."
  @spec any?(Path.t()) :: boolean()
  def any?(dataset), do: dataset |> experiments_folder() |> File.dir?()

  @doc "Returns the folder of all experiments over a dataset."
  @spec experiments_folder(Path.t()) :: Path.t()
  def experiments_folder(dataset) do
    {:ok, folder} = RunRecord.experiments_folder(dataset)
    folder
  end

  @doc "Returns a term that changes when a file changes that `load_run/2` reads."
  @spec stamp_files(Path.t()) :: term()
  def stamp_files(dataset) do
    for folder <- ResultsFile.list_files(experiments_folder(dataset), ""),
        path <-
          [
            ResultsFile.file_path(folder),
            Comments.file_path(folder),
            Baseline.promoted_path(folder)
          ] ++
            ResultsFile.list_files(Path.join(folder, "runs"), ".json"),
        {:ok, stat} <- [File.stat(path)],
        do: {path, stat.size, stat.mtime, stat.inode}
  end

  @doc "Reads a run with that name, or the latest one. A run that does not exist has no rows."
  @spec load_run(Path.t(), String.t() | nil) :: t()
  def load_run(dataset, name) do
    experiments = experiments_folder(dataset)
    runs = RunRecord.list_runs(experiments)
    state = %__MODULE__{runs: Enum.map(runs, fn {_, run} -> describe_run(run) end)}

    case RunRecord.fetch_run(experiments, name) do
      {:ok, {folder, run}} ->
        read_run(%{state | folder: folder, run: run, status: RunRecord.status(run)}, runs)

      {:error, _} ->
        state
    end
  end

  defp describe_run(run),
    do: %{name: run["run"], experiment: run["experiment"], status: RunRecord.status(run)}

  defp read_run(%{folder: folder, run: run} = state, runs) do
    rows = Summary.list_rows(folder, run)

    %{
      state
      | rows: rows,
        progress:
          Progress.measure_progress(run, ResultsFile.read_results(folder), Situ.Time.now()),
        baseline: find_baseline(state, rows, runs),
        comments: Comments.list_comments(folder, run["run"])
    }
  end

  defp find_baseline(%{folder: folder} = state, rows, runs) do
    with {:ok, %{"run" => name, "set" => set} = baseline} <-
           Baseline.read_file(Baseline.promoted_path(folder)),
         {_, run} <- Enum.find(runs, fn {at, run} -> at == folder and run["run"] == name end) do
      same = Enum.find(rows, &(&1.parameters == baseline["parameters"]))

      metrics =
        for {metric, %{"sessions" => values}} <- baseline["metrics"],
            into: %{},
            do: {metric, values}

      %{
        folder: folder,
        run: run,
        set: set,
        number: if(name == state.run["run"], do: set, else: same && same.number),
        promoted?: true,
        metrics: metrics
      }
    else
      _ -> best_set(state, rows)
    end
  end

  defp best_set(state, [%{sessions: n} = best | _]) when n > 0 do
    metrics = Map.new(best.metrics, fn {name, m} -> {name, Map.new(m.sessions)} end)

    %{
      folder: state.folder,
      run: state.run,
      set: best.number,
      number: best.number,
      promoted?: false,
      metrics: metrics
    }
  end

  defp best_set(_state, _rows), do: nil

  @doc "Returns the metric with that name in the run, or the first one; `nil` if the run has none."
  @spec find_metric(t(), String.t() | nil) :: map() | nil
  def find_metric(%__MODULE__{run: %{"metrics" => metrics}}, name),
    do: Enum.find(metrics, List.first(metrics), &(&1["name"] == name))

  def find_metric(_state, _name), do: nil

  @doc """
  Returns the sessions of a set from the worst to the best by a metric, as `{session, value, baseline's value}`.
  Sessions with an undefined value come last.
  """
  @spec rank_sessions(t(), Summary.row(), map()) :: [{String.t(), number() | nil, number() | nil}]
  def rank_sessions(%__MODULE__{baseline: baseline}, row, %{"name" => name} = metric) do
    values = Map.new(row.metrics[name].sessions)
    before = (baseline && baseline.metrics[name]) || %{}
    worst = row.metrics[name] |> Summary.worst_sessions(metric) |> Enum.map(&elem(&1, 0))
    rest = for {session, nil} <- row.metrics[name].sessions, do: session
    for session <- worst ++ rest, do: {session, values[session], before[session]}
  end

  @doc """
  Returns the session in which a set and the baseline differ most by a metric: the session to look at first. For the
  baseline itself, this is its worst session.
  """
  @spec choose_session(t(), Summary.row(), map()) :: String.t() | nil
  def choose_session(state, row, metric) do
    case rank_sessions(state, row, metric) do
      [] ->
        nil

      ranked ->
        {session, _, _} =
          Enum.max_by(ranked, fn {_, value, before} -> time_distance(value, before) end)

        session
    end
  end

  defp time_distance(a, b) when is_number(a) and is_number(b), do: abs(a - b)
  defp time_distance(_, _), do: 0
end

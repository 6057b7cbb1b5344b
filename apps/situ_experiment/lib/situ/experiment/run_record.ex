defmodule Situ.Experiment.RunRecord do
  @moduledoc false
  # A run of an experiment, as a file of JSON: `runs/RUN.json` in the experiment's folder. The results of its sessions
  # and sets are in the results file, under the keys that the run lists.
  alias Situ.{Dataset, Error, Options}
  alias Situ.Experiment.ResultsFile

  @type t :: map()

  @doc "Returns the folder of all experiments over a dataset. Error: `:no_file`."
  @spec experiments_folder(Dataset.t() | Path.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def experiments_folder(%Dataset{file: nil}) do
    {:error,
     Error.new(:no_file, "the dataset does not have a file, so its results have no place",
       fix: "make a dataset file: situ dataset create FILE.json FOLDER"
     )}
  end

  def experiments_folder(%Dataset{file: file}), do: {:ok, file <> ".experiments"}
  def experiments_folder(path), do: {:ok, Path.expand(path) <> ".experiments"}

  @doc "Returns a new name: the time, and a number if another run began in the same second."
  @spec new_name(Path.t(), Situ.Time.t()) :: String.t()
  def new_name(folder, now) do
    time =
      now |> div(1_000_000_000) |> DateTime.from_unix!() |> Calendar.strftime("%Y%m%d-%H%M%S")

    [time]
    |> Stream.concat(Stream.map(Stream.iterate(2, &(&1 + 1)), &"#{time}-#{&1}"))
    |> Enum.find(&(not File.exists?(run_path(folder, &1))))
  end

  @doc "Writes the record."
  @spec write_run(Path.t(), t()) :: :ok | {:error, Error.t()}
  def write_run(folder, run), do: ResultsFile.write_json(run_path(folder, run["run"]), run)

  @doc "Lists the runs of all experiments over a dataset, oldest first, as `{folder, run}`."
  @spec list_runs(Path.t()) :: [{Path.t(), t()}]
  def list_runs(experiments) do
    for experiment <- ResultsFile.list_files(experiments, ""),
        path <- ResultsFile.list_files(Path.join(experiment, "runs"), ".json"),
        {:ok, %{"run" => _} = run} <- [ResultsFile.read_json(path)] do
      {experiment, run}
    end
    |> Enum.sort_by(fn {_, run} -> run["started"] end)
  end

  @doc """
  Returns a run by its name. For `nil`, returns the latest one, or the latest check if nothing else has run. Error:
  `:no_run`.
  """
  @spec fetch_run(Path.t(), String.t() | nil) :: {:ok, {Path.t(), t()}} | {:error, Error.t()}
  def fetch_run(experiments, name) do
    runs = list_runs(experiments)

    case {Enum.find(runs, fn {_, run} -> name == nil or run["run"] == name end), runs} do
      {_, []} ->
        {:error,
         Error.new(:no_run, "no experiment has run over this dataset",
           fix: "run one: situ experiment run FILE.exs DATASET.json"
         )}

      {nil, runs} ->
        names = Enum.map(runs, fn {_, run} -> run["run"] end)
        near = Options.nearest_name(name, names) || List.last(names)

        {:error,
         Error.new(:no_run, "run #{inspect(name)} does not exist", fix: "did you mean #{near}?")}

      {_, runs} when name == nil ->
        {:ok, runs |> Enum.reject(&check?/1) |> List.last(List.last(runs))}

      {run, _} ->
        {:ok, run}
    end
  end

  # A check has one set. As the latest run, a regression would become the baseline, and the others would be hidden.
  defp check?({_folder, run}), do: run["method"] == "check"

  @doc """
  Returns the status of a run: `finished`, `running`, `interrupted` by Ctrl-C, or `killed` if its process is gone.
  """
  @spec status(t()) :: String.t()
  def status(%{"status" => "running", "pid" => pid}),
    do: if(File.dir?("/proc/#{pid}"), do: "running", else: "killed")

  def status(run), do: run["status"]

  @doc "Marks the runs of this process over a dataset that have not finished as interrupted."
  @spec mark_interrupted(Dataset.t()) :: :ok
  def mark_interrupted(%Dataset{} = dataset) do
    with {:ok, experiments} <- experiments_folder(dataset) do
      for {folder, %{"status" => "running"} = run} <- list_runs(experiments),
          run["pid"] == System.pid(),
          do: write_run(folder, %{run | "status" => "interrupted"})
    end

    :ok
  end

  defp run_path(folder, name), do: Path.join([folder, "runs", name <> ".json"])
end

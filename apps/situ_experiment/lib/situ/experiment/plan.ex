defmodule Situ.Experiment.Plan do
  @moduledoc false
  # The sets, sessions and folder of a run, after everything that the experiment returns has been checked.
  alias Situ.{Dataset, Error, Metric}
  alias Situ.Experiment.{Parameters, RunRecord, Search}

  @enforce_keys [:module, :name, :folder, :sets, :sessions, :opts]
  defstruct [:module, :name, :folder, :sets, :sessions, :opts]

  @type t :: %__MODULE__{
          module: module(),
          name: String.t(),
          folder: Path.t(),
          sets: [Parameters.t()],
          sessions: [Dataset.Session.t()],
          opts: keyword()
        }

  @doc """
  Plans a run with the options of the runner. Errors: `:no_file`, `:bad_parameters`, `:bad_metrics`, `:no_set`,
  `:no_session`.
  """
  @spec new(module(), Dataset.t(), keyword()) :: {:ok, t()} | {:error, Error.t()}
  def new(module, %Dataset{} = dataset, opts) do
    with {:ok, experiments} <- RunRecord.experiments_folder(dataset),
         {:ok, sets} <- Parameters.list_sets(module.parameters()),
         :ok <- check_metrics(module.metrics()),
         {:ok, sets} <- choose_sets(sets, opts),
         {:ok, sessions} <- choose_sessions(module, dataset, opts) do
      # The last part of the module's name.
      name = module |> Module.split() |> List.last()
      folder = Path.join(experiments, name)

      {:ok,
       %__MODULE__{
         module: module,
         name: name,
         folder: folder,
         sets: sets,
         sessions: sessions,
         opts: opts
       }}
    end
  end

  defp check_metrics(metrics) do
    metric? = &(is_struct(&1, Metric) or is_function(&1, 1))

    if Keyword.keyword?(metrics) and metrics != [] and
         Enum.all?(metrics, fn {_, m} -> metric?.(m) end) do
      :ok
    else
      {:error,
       Error.new(:bad_metrics, "metrics/0 returned #{inspect(metrics, limit: 3)}",
         why: "an experiment needs at least one metric",
         fix: "name each metric: [speaking: Situ.Metric.intervals(truth: \"Speaking.Truth\")]"
       )}
    end
  end

  defp choose_sets(sets, opts) do
    cond do
      opts[:only] ->
        choose_only(sets, opts[:only])

      opts[:method] == :random ->
        {:ok,
         sets
         |> Search.shuffle(opts[:seed])
         |> Enum.take(opts[:trials])
         |> Enum.sort_by(& &1.number)}

      true ->
        {:ok, sets}
    end
  end

  defp choose_only(sets, only) do
    case Enum.find(sets, &(&1.json == only)) do
      nil ->
        {:error,
         Error.new(:no_set, "the experiment has no set of parameters #{Situ.JSON.encode(only)}",
           why: "parameters/0 does not list these values",
           fix: "add the values to parameters/0"
         )}

      set ->
        {:ok, [set]}
    end
  end

  defp choose_sessions(module, dataset, opts) do
    fits? = opts[:sessions] || fn _ -> true end

    case Enum.filter(module.sessions(dataset), fits?) do
      [] ->
        {:error,
         Error.new(:no_session, "no session takes part",
           why: "the dataset has #{length(dataset.sessions)} sessions",
           fix: "check sessions/1 of the experiment, and the conditions of the command"
         )}

      sessions ->
        {:ok, sessions}
    end
  end
end

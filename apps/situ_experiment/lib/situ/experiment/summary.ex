defmodule Situ.Experiment.Summary do
  @moduledoc false
  # Summarizes a run: the values of each set of parameters over the sessions with their 95 % intervals, and comparisons
  # of two sets. It needs the files of the run, not the code of the experiment.
  alias Situ.{Error, Metric}
  alias Situ.Experiment.ResultsFile
  alias Situ.Metric.{Statistics, StoredMetric}

  @type metric_row :: %{
          value: number() | nil,
          interval: {number(), number()} | nil,
          values: %{String.t() => number() | nil},
          sessions: [{String.t(), number() | nil}]
        }
  @type row :: %{
          number: pos_integer(),
          label: String.t(),
          parameters: map(),
          texts: %{String.t() => String.t()},
          sessions: non_neg_integer(),
          failures: [{String.t(), String.t()}],
          machines: [String.t()],
          metrics: %{String.t() => metric_row()}
        }

  @doc "Returns the sets of a run as rows, the best set of the first metric first."
  @spec list_rows(Path.t(), map()) :: [row()]
  def list_rows(folder, run) do
    results = ResultsFile.read_results(folder)
    by_set = Enum.group_by(run["trials"], & &1["set"], &results[&1["key"]])
    rows = for set <- run["sets"], do: build_row(set, Map.get(by_set, set["number"], []), run)
    sort_rows(rows, run["metrics"])
  end

  defp build_row(set, results, run) do
    done = for %{"status" => "done"} = result <- results, do: result

    %{
      number: set["number"],
      label: set["label"],
      parameters: set["parameters"],
      texts:
        set["texts"] || Map.new(set["parameters"], fn {k, v} -> {k, Situ.JSON.encode(v)} end),
      sessions: length(done),
      failures: for(%{"status" => "failed"} = r <- results, do: {r["session"], r["error"]}),
      machines: for(%{"machine" => machine} <- done, uniq: true, do: machine),
      metrics: Map.new(run["metrics"], &{&1["name"], summarize_metric(&1, done, run["seed"])})
    }
  end

  defp summarize_metric(description, results, seed) do
    metric = StoredMetric.from_json(description)
    measured = for r <- results, c = counts_of(r, description), do: {r["session"], c}
    counts = Enum.map(measured, &elem(&1, 1))
    values = Metric.summarize(metric, counts)

    %{
      value: values[metric.main],
      interval: Statistics.bootstrap_interval(counts, main_statistic(metric), seed),
      values: values,
      sessions: for({name, c} <- measured, do: {name, Metric.summarize(metric, [c])[metric.main]})
    }
  end

  defp counts_of(result, description),
    do: get_in(result, ["measurements", description["name"], "counts"])

  defp main_statistic(metric), do: &Metric.summarize(metric, &1)[metric.main]

  # Sets that ran over fewer sessions, because a search dropped them, come after the others.
  defp sort_rows(rows, [%{"name" => name} = first | _]) do
    sign = if first["better"][first["main"]] == "lower", do: 1, else: -1

    Enum.sort_by(rows, fn row ->
      value = row.metrics[name].value
      {-row.sessions, value == nil, sign * (value || 0), row.number}
    end)
  end

  defp sort_rows(rows, []), do: rows

  @doc """
  Compares two sets on the sessions that both have run over. Returns one map for each metric: `first`, `second`, their
  `difference` with its `interval` and `p`, and the sessions `better` and `worse` with their differences, largest first.
  """
  @spec compare_sets(Path.t(), map(), {pos_integer(), pos_integer()}) ::
          {:ok, [map()]} | {:error, Error.t()}
  def compare_sets(folder, run, {first, second}) do
    with {:ok, a} <- fetch_results(folder, run, first),
         {:ok, b} <- fetch_results(folder, run, second) do
      {:ok, Enum.map(run["metrics"], &compare_metric(&1, a, b, run["seed"]))}
    end
  end

  @doc "Returns the results of a set by session. Error: `:no_set`."
  @spec fetch_results(Path.t(), map(), pos_integer()) ::
          {:ok, %{String.t() => map()}} | {:error, Error.t()}
  def fetch_results(folder, run, number) do
    if Enum.any?(run["sets"], &(&1["number"] == number)) do
      results = ResultsFile.read_results(folder)

      {:ok,
       for(
         %{"set" => ^number, "key" => key, "session" => session} <- run["trials"],
         result = results[key],
         into: %{},
         do: {session, result}
       )}
    else
      numbers = Enum.map_join(run["sets"], ", ", &to_string(&1["number"]))

      {:error,
       Error.new(:no_set, "run #{run["run"]} has no set #{number}", fix: "use #{numbers}")}
    end
  end

  defp compare_metric(description, a, b, seed) do
    metric = StoredMetric.from_json(description)

    pairs =
      for {session, x} <- Enum.sort(a),
          c = counts_of(x, description),
          d = counts_of(b[session] || %{}, description),
          do: {session, c, d}

    result =
      Statistics.compare_pairs(for({_, c, d} <- pairs, do: {c, d}), main_statistic(metric), seed)

    {better, worse} = split_sessions(metric, pairs)

    Map.merge(result, %{
      name: description["name"],
      main: metric.main,
      sessions: length(pairs),
      first: Metric.summarize(metric, for({_, c, _} <- pairs, do: c))[metric.main],
      second: Metric.summarize(metric, for({_, _, d} <- pairs, do: d))[metric.main],
      better: better,
      worse: worse
    })
  end

  defp split_sessions(metric, pairs) do
    sign = if Metric.direction(metric, metric.main) == :higher, do: 1, else: -1
    value = &Metric.summarize(metric, [&1])[metric.main]

    changes =
      for {session, c, d} <- pairs,
          x = value.(c),
          y = value.(d),
          x != y,
          do: {session, y - x}

    {better, worse} = Enum.split_with(changes, fn {_, change} -> sign * change > 0 end)
    largest = &Enum.sort_by(&1, fn {_, change} -> -abs(change) end)
    {largest.(better), largest.(worse)}
  end

  @doc "Returns the sessions of a metric from the worst to the best; sessions with an undefined value are left out."
  @spec worst_sessions(metric_row(), map()) :: [{String.t(), number()}]
  def worst_sessions(row, description) do
    sign = if description["better"][description["main"]] == "lower", do: -1, else: 1
    known = for {session, value} <- row.sessions, is_number(value), do: {session, value}
    Enum.sort_by(known, fn {session, value} -> {sign * value, session} end)
  end
end

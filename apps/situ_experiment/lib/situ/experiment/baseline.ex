defmodule Situ.Experiment.Baseline do
  @moduledoc false
  # The values that an experiment must not fall below: a file of JSON that `situ experiment promote` writes and people
  # may edit, above all its tolerances.
  alias Situ.Error
  alias Situ.Experiment.{ResultsFile, Summary}

  # Scores from 0 to 1 may vary by this much, and all other values by a tenth of themselves.
  @score_tolerance 0.02
  @relative_tolerance 0.1

  @type t :: map()
  @type finding :: %{
          name: String.t(),
          baseline: number() | nil,
          now: number() | nil,
          tolerance: number() | nil,
          status: :ok | :worse | :unchecked,
          sessions: [{String.t(), number(), number(), [[term()]]}]
        }

  @doc "Builds the baseline of one set of a run. Error: `:no_set`, `:failed_sessions`."
  @spec from_run(Path.t(), map(), pos_integer()) :: {:ok, t()} | {:error, Error.t()}
  def from_run(folder, run, number) do
    with {:ok, results} <- Summary.fetch_results(folder, run, number),
         :ok <- check_complete(results) do
      row = folder |> Summary.list_rows(run) |> Enum.find(&(&1.number == number))

      {:ok,
       %{
         "experiment" => run["experiment"],
         "run" => run["run"],
         "set" => number,
         "parameters" => row.parameters,
         "sessions" => results |> Map.keys() |> Enum.sort(),
         "metrics" => Map.new(run["metrics"], &{&1["name"], describe_metric(&1, row, results)}),
         "environment" => run["environment"]
       }}
    end
  end

  @doc "Returns the path of the baseline of an experiment, in its folder."
  @spec promoted_path(Path.t()) :: Path.t()
  def promoted_path(folder), do: Path.join(folder, "baseline.json")

  @doc "Makes a set the baseline of its experiment, and returns it. Errors: see `from_run/3`, and `:not_saved`."
  @spec promote_set(Path.t(), map(), pos_integer()) :: {:ok, t()} | {:error, Error.t()}
  def promote_set(folder, run, number) do
    with {:ok, baseline} <- from_run(folder, run, number),
         :ok <- ResultsFile.write_json(promoted_path(folder), baseline),
         do: {:ok, baseline}
  end

  defp check_complete(results) do
    case for {session, %{"status" => "failed"}} <- results, do: session do
      [] when map_size(results) > 0 ->
        :ok

      failed ->
        {:error,
         Error.new(:failed_sessions, "a set with failed or missing sessions cannot be a baseline",
           why: "failed: #{Enum.join(failed, ", ")}",
           fix: "run the experiment until all sessions of the set succeed"
         )}
    end
  end

  defp describe_metric(%{"name" => name, "main" => main} = metric, row, results) do
    %{value: value, interval: interval, sessions: sessions} = row.metrics[name]

    %{
      "main" => main,
      "better" => metric["better"][main],
      "value" => value,
      "interval" => interval && Tuple.to_list(interval),
      "tolerance" => default_tolerance(main, value),
      "sessions" => Map.new(sessions),
      "moments" => for({session, r} <- results, into: %{}, do: {session, moments_of(r, name)})
    }
  end

  # The computing time depends on the machine, so it is not checked unless somebody gives it a tolerance.
  defp default_tolerance("busy_s_per_s", _value), do: nil

  defp default_tolerance(main, _)
       when main in ~w(f1 time_f1 precision recall kappa accuracy macro_f1 map mota idf1 r2 wer cpwer tcpwer),
       do: @score_tolerance

  defp default_tolerance(_main, nil), do: nil
  defp default_tolerance(_main, value), do: abs(value) * @relative_tolerance

  defp moments_of(result, name), do: get_in(result, ["measurements", name, "moments"]) || []

  @doc "Reads a baseline. Errors: `:not_found`, `:bad_json`, `:bad_baseline`."
  @spec read_file(Path.t()) :: {:ok, t()} | {:error, Error.t()}
  def read_file(path) do
    case ResultsFile.read_json(path) do
      {:ok, %{"parameters" => %{}, "metrics" => %{}, "sessions" => [_ | _]} = baseline} ->
        {:ok, baseline}

      {:ok, _} ->
        {:error,
         Error.new(:bad_baseline, "#{path} is not a baseline",
           fix: "write one with situ experiment promote"
         )}

      error ->
        error
    end
  end

  @doc """
  Compares a run of the baseline's set with the baseline. A metric is worse if its value has moved by more than its
  tolerance in the wrong direction, or if it is undefined now; `sessions` then lists the sessions that became worse,
  with both values and the moments that are wrong now but were not in the baseline.
  """
  @spec check_run(t(), Path.t(), map(), pos_integer()) :: {:ok, [finding()]} | {:error, Error.t()}
  def check_run(baseline, folder, run, number) do
    with {:ok, results} <- Summary.fetch_results(folder, run, number) do
      row = folder |> Summary.list_rows(run) |> Enum.find(&(&1.number == number))
      names = for %{"name" => name} <- run["metrics"], do: name

      {:ok,
       for {name, expected} <- Enum.sort(baseline["metrics"]) do
         check_metric(name, expected, name in names && row.metrics[name], results)
       end}
    end
  end

  defp check_metric(name, expected, row, results) do
    now = row && row.value
    status = compare_value(expected, now)

    sessions =
      if status == :worse and row, do: worse_sessions(name, expected, row, results), else: []

    %{
      name: "#{name}.#{expected["main"]}",
      baseline: expected["value"],
      now: now || nil,
      tolerance: expected["tolerance"],
      status: status,
      sessions: sessions
    }
  end

  defp compare_value(%{"tolerance" => nil}, _now), do: :unchecked
  defp compare_value(%{"value" => nil}, _now), do: :unchecked
  defp compare_value(_expected, now) when not is_number(now), do: :worse

  defp compare_value(expected, now) do
    if measure_loss(expected, expected["value"], now) > expected["tolerance"],
      do: :worse,
      else: :ok
  end

  defp measure_loss(%{"better" => "lower"}, before, now), do: now - before
  defp measure_loss(_expected, before, now), do: before - now

  defp worse_sessions(name, expected, row, results) do
    for {session, now} <- row.sessions,
        before = expected["sessions"][session],
        is_number(before) and is_number(now) and measure_loss(expected, before, now) > 0 do
      {session, before, now,
       new_moments(expected["moments"][session] || [], results[session], name)}
    end
    |> Enum.sort_by(fn {_, before, now, _} -> -abs(before - now) end)
  end

  # A moment is new if the baseline has no moment of the same kind and track that overlaps with it.
  defp new_moments(before, result, name) do
    origin = result["from"] || 0

    for [kind, track, from, to] <- moments_of(result, name),
        not Enum.any?(before, fn [k, t, a, b] ->
          k == kind and t == track and a < to and b > from
        end),
        do: [kind, track, (from - origin) / 1.0e9, (to - origin) / 1.0e9]
  end
end

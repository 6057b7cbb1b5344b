defmodule Situ.Experiment.Trial do
  @moduledoc false
  # One session with one set of parameters: runs the pipeline, records its streams and measures them.
  alias Situ.Dataset.{OpenSession, Session, StoreVersion}
  alias Situ.Experiment.{BusyTime, CodeVersion, Context, Input, Parameters, Provenance}
  alias Situ.Metric.Measurement
  alias Situ.{Error, Pipeline, Store}

  @enforce_keys [:session, :set, :stamp, :key, :metrics_key]
  defstruct [:session, :set, :stamp, :key, :metrics_key, :opened]

  @type t :: %__MODULE__{
          session: Session.t(),
          set: Parameters.t(),
          stamp: String.t(),
          key: String.t(),
          metrics_key: String.t(),
          opened: {OpenSession.t(), {Situ.Time.t(), Situ.Time.t()}} | nil
        }

  @doc "Builds the trial of a session and a set. Its key identifies the code, the parameters and the recordings."
  @spec new(Context.t(), Session.t(), Parameters.t(), String.t()) :: t()
  def new(%Context{} = context, session, set, stamp) do
    build = CodeVersion.hash_function(context.code, context.module, :build)
    metrics = CodeVersion.hash_function(context.code, context.module, :metrics)
    speed = Context.speed(context)
    values = CodeVersion.hash_values(context.code, set.values)
    key = CodeVersion.hash_term({build, values, session.name, stamp, speed})

    %__MODULE__{
      session: session,
      set: set,
      stamp: stamp,
      key: String.slice(key, 0, 32),
      metrics_key: String.slice(CodeVersion.hash_term({metrics, stamp}), 0, 16)
    }
  end

  @doc "Runs the trial and returns the result to store."
  @spec run_trial(t(), Context.t()) :: map()
  def run_trial(%__MODULE__{} = trial, %Context{} = context) do
    started = System.monotonic_time(:millisecond)

    outcome =
      with {:ok, path, busy_s} <-
             run_pipeline(trial, context, Path.join(context.folder, "outputs")),
           do: measure_output(trial, context, path, busy_s)

    took_s = (System.monotonic_time(:millisecond) - started) / 1000
    measured = %{"took_s" => took_s, "machine" => Provenance.name_machine()}
    trial |> describe(context, outcome) |> Map.merge(measured)
  end

  @doc "Returns the result of a trial that could not be computed."
  @spec describe_failure(t(), Context.t(), Error.t()) :: map()
  def describe_failure(%__MODULE__{} = trial, %Context{} = context, error),
    do: trial |> describe(context, {:error, error}) |> Map.put("took_s", 0.0)

  @doc "Measures the output of an earlier result again, after a change of the metrics."
  @spec measure_again(t(), Context.t(), map()) :: map()
  def measure_again(%__MODULE__{} = trial, %Context{} = context, result) do
    path = Path.join(context.folder, result["output"])
    outcome = measure_output(trial, context, path, result["busy_s"])
    earlier = Map.take(result, ["took_s", "machine", "node"])
    trial |> describe(context, outcome) |> Map.merge(earlier)
  end

  @doc "Runs the pipeline; its streams become the next version of the recording `folder/KEY`. Returns its path."
  @spec run_pipeline(t(), Context.t(), Path.t()) ::
          {:ok, Path.t(), busy_s :: float()} | {:error, Error.t()}
  def run_pipeline(%__MODULE__{} = trial, %Context{} = context, folder) do
    path = Path.join(folder, trial.key)
    draft = StoreVersion.draft_path(path)
    context = %{context | owner: self()}

    build = fn p ->
      input = %Input{
        pipeline: p,
        session: trial.session,
        context: context,
        stamp: trial.stamp,
        opened: trial.opened && elem(trial.opened, 0)
      }

      streams = check_streams(context.module.build(p, input, trial.set.values))
      exporter = Store.create(p, trial.key, draft, versioned: false)
      for {name, stream} <- streams, do: Store.write(stream, exporter, name)
      :built
    end

    with {:ok, report} <- Pipeline.run(build, pipeline: Context.pipeline_settings(context)),
         {:ok, output} <- StoreVersion.publish_draft(draft, path) do
      {:ok, output, BusyTime.total_seconds(report.snapshot) + Enum.sum(collect_stages(%{}))}
    else
      {:error, error} ->
        _ = collect_stages(%{})
        StoreVersion.discard_draft(draft)
        {:error, error}
    end
  end

  defp collect_stages(stages) do
    receive do
      {:stage_used, _pid, folder, busy_s} -> collect_stages(Map.put(stages, folder, busy_s))
    after
      0 -> Map.values(stages)
    end
  end

  defp check_streams(streams)
       when (is_map(streams) and not is_struct(streams)) or is_list(streams) do
    for entry <- streams do
      case entry do
        {name, %Situ.Stream{} = stream} when is_atom(name) or is_binary(name) ->
          {to_string(name), stream}

        other ->
          raise build_error(other)
      end
    end
  end

  defp check_streams(other), do: raise(build_error(other))

  defp build_error(other) do
    Error.new(:bad_build, "build/3 returned #{inspect(other, limit: 3)}",
      fix: ~s(return the streams by name: %{"Speaking" => speaking})
    )
  end

  # Metrics may be functions of the user, so their exceptions are results, too.
  defp measure_output(trial, context, path, busy_s) do
    with {:ok, output} <- Store.open(path) do
      {open, span} = trial.opened || open_session(trial.session)

      measured = %{
        session: open,
        output: output,
        span: span,
        parameters: trial.set.values,
        busy_s: busy_s
      }

      with {:ok, measurements} <-
             Measurement.measure_all(context.module.metrics(), measured, Context.speed(context)) do
        {from, to} = measured.span

        {:ok, path,
         %{"measurements" => measurements, "busy_s" => busy_s, "from" => from, "to" => to}}
      end
    end
  rescue
    error in Error ->
      {:error, error}

    error ->
      {:error,
       Error.new(:metric_failed, "a metric failed: #{Exception.message(error)}",
         why: Error.format_location(__STACKTRACE__)
       )}
  end

  @doc """
  Opens the recordings of a session for the metrics, and finds the times of its first and last message. Trials of the
  same session share the result.
  """
  @spec open_session(Session.t()) :: {OpenSession.t(), {Situ.Time.t(), Situ.Time.t()}}
  def open_session(%Session{} = session) do
    open = OpenSession.open(session)
    spans = for {_, store} <- open.stores, span = Store.interval(store), do: span
    {from, to} = Enum.unzip(spans)
    {open, {Enum.min(from, fn -> 0 end), Enum.max(to, fn -> 0 end)}}
  end

  defp describe(trial, context, outcome) do
    base = %{
      "key" => trial.key,
      "metrics" => trial.metrics_key,
      "session" => trial.session.name,
      "parameters" => trial.set.json
    }

    case outcome do
      {:ok, path, measured} ->
        base
        |> Map.merge(measured)
        |> Map.merge(%{"status" => "done", "output" => Path.relative_to(path, context.folder)})

      {:error, error} ->
        Map.merge(base, %{"status" => "failed", "error" => Exception.message(error)})
    end
  end
end

defmodule Situ.CLI.Experiment.Checking do
  @moduledoc false
  # `situ experiment promote`, `check` and `reproduce`: baselines, and the same results again.
  alias Situ.CLI.Experiment.{Loading, Running}
  alias Situ.CLI.{Output, Terminal}
  alias Situ.Experiment.{Baseline, ReportTable, Reproduction, ResultsFile, Summary}
  alias Situ.Error

  @doc "Writes the baseline of a set."
  @spec promote_set(map(), keyword()) :: 0
  def promote_set(%{dataset: path}, opts) do
    {folder, run} = Loading.fetch_run!(path, opts[:run])
    number = opts[:set] || best_set(folder, run)
    baseline = Error.unwrap!(Baseline.from_run(folder, run, number))
    Error.unwrap!(ResultsFile.write_json(opts[:output], baseline))

    if opts[:json],
      do: Output.print_json(%{file: opts[:output], run: run["run"], set: number}),
      else: Output.puts("#{opts[:output]}: set #{number} of run #{run["run"]}")

    0
  end

  defp best_set(folder, run), do: hd(Summary.list_rows(folder, run)).number

  @doc "Runs the set of a baseline again and compares; returns 1 if a metric is worse."
  @spec check_baseline(map(), keyword()) :: 0..255
  def check_baseline(%{file: file, dataset: path}, opts) do
    baseline = Error.unwrap!(Baseline.read_file(opts[:baseline]))
    experiment = Loading.load_experiment!(file)
    dataset = Loading.open_dataset!(path)
    for name <- baseline["sessions"], do: Error.unwrap!(Situ.Dataset.session(dataset, name))

    settings = [
      jobs: max(opts[:jobs], 1),
      only: baseline["parameters"],
      sessions: &(&1.name in baseline["sessions"])
    ]

    case Running.run_interruptibly(experiment, dataset, settings, opts) do
      {:ok, {folder, run}} -> report_check(baseline, folder, run, opts)
      :interrupted -> 130
      {:error, error} -> raise error
    end
  end

  defp report_check(baseline, folder, run, opts) do
    [%{"number" => number}] = run["sets"]
    findings = Error.unwrap!(Baseline.check_run(baseline, folder, run, number))
    failed = for row <- Summary.list_rows(folder, run), failure <- row.failures, do: failure
    worse? = failed != [] or Enum.any?(findings, &(&1.status == :worse))

    if opts[:json],
      do:
        Output.print_json(%{
          ok: not worse?,
          metrics: Enum.map(findings, &finding_json/1),
          failed: Map.new(failed)
        }),
      else: print_findings(findings, failed)

    if worse?, do: 1, else: 0
  end

  defp print_findings(findings, failed) do
    rows =
      for f <- findings do
        [
          f.name,
          to_string(f.status)
          | Enum.map([f.baseline, f.now, f.tolerance], &ReportTable.format_value/1)
        ]
      end

    Output.print_table([["metric", "status", "baseline", "now", "tolerance"] | rows], 2)

    for f <- findings, {session, before, now, moments} <- Enum.take(f.sessions, 5) do
      Output.puts(
        "#{f.name} fell in #{session}: #{ReportTable.format_value(before)} -> #{ReportTable.format_value(now)}"
      )

      for moment <- Enum.take(moments, 5), do: Output.puts("    " <> format_moment(moment))
    end

    for {session, error} <- failed, do: Output.puts("#{session} failed: #{error}")
  end

  defp format_moment([kind, track, from, to]) do
    name = if track == "", do: kind, else: "#{kind} on #{track}"
    "#{name} from #{ReportTable.format_value(from)} s to #{ReportTable.format_value(to)} s"
  end

  defp finding_json(finding) do
    sessions =
      for {session, before, now, moments} <- finding.sessions,
          do: %{session: session, baseline: before, now: now, moments: moments}

    %{finding | sessions: sessions}
  end

  @doc "Computes a set of a run again; returns 1 if a stream differs."
  @spec reproduce_run(map(), keyword()) :: 0 | 1
  def reproduce_run(%{dataset: path, run: name}, opts) do
    {folder, run} = Loading.fetch_run!(path, name)
    experiment = Loading.load_experiment!(opts[:file] || experiment_source!(run))
    dataset = Loading.open_dataset!(path)
    terminal = Terminal.open(opts)

    settings = [
      set: opts[:set] || best_set(folder, run),
      file: experiment.file,
      binaries: experiment.binaries,
      progress: &Terminal.replace_line(terminal, "computed #{Output.format_name(&1)} again")
    ]

    report =
      Error.unwrap!(
        Reproduction.reproduce_set(experiment.module, dataset, {folder, run}, settings)
      )

    Terminal.close(terminal)
    if opts[:json], do: Output.print_json(report_json(report)), else: print_report(report)
    if reproduced?(report), do: 0, else: 1
  end

  defp experiment_source!(run) do
    run["environment"]["file"] || run["module"] ||
      raise Error.new(:no_file, "run #{run["run"]} does not name a file",
              fix: "give --file FILE.exs, or the name of the module"
            )
  end

  defp reproduced?(report),
    do: Enum.all?(report.outcomes, &(&1.differences == [] and &1.error == nil))

  defp print_report(report) do
    if report.changes != [],
      do: Output.puts("Changed since the run: #{Enum.join(report.changes, ", ")}")

    for %{session: session} = outcome <- report.outcomes do
      if outcome.error, do: Output.puts("#{session}: #{Exception.message(outcome.error)}")
      for {stream, why} <- outcome.differences, do: Output.puts("#{session}: #{stream}: #{why}")
    end

    if reproduced?(report),
      do:
        Output.puts(
          "Set #{report.set}: all streams of #{Output.format_count(length(report.outcomes), "session")} are equal"
        )
  end

  defp report_json(report) do
    sessions =
      for o <- report.outcomes do
        %{
          session: o.session,
          differences: Map.new(o.differences),
          error: o.error && Exception.message(o.error)
        }
      end

    %{set: report.set, equal: reproduced?(report), changes: report.changes, sessions: sessions}
  end
end

defmodule Situ.CLI.Experiment.Checking do
  @moduledoc false
  # `situ experiment promote`, `check` and `reproduce`: baselines, and the same results again.
  alias Situ.CLI.Experiment.{Bisecting, Loading, Running}
  alias Situ.CLI.{Output, Terminal}
  alias Situ.{Dataset, Error}

  alias Situ.Experiment.{
    Baseline,
    DifferenceFiles,
    ReportTable,
    Reproduction,
    ResultsFile,
    RunRecord,
    Summary
  }

  @default_file "baseline.json"
  # Differences of more sessions are found in the studio.
  @most_recordings 3

  @doc "Makes a set the baseline of its experiment, and writes it to a file."
  @spec promote_set(map(), keyword()) :: 0
  def promote_set(%{dataset: path}, opts) do
    {folder, run} = Loading.fetch_run!(path, opts[:run])
    number = opts[:set] || best_set(folder, run)
    baseline = Error.unwrap!(Baseline.promote_set(folder, run, number))
    Error.unwrap!(ResultsFile.write_json(opts[:output], baseline))

    if opts[:json],
      do: Output.print_json(%{file: opts[:output], run: run["run"], set: number}),
      else: Output.puts("#{opts[:output]}: set #{number} of run #{run["run"]}")

    0
  end

  defp best_set(folder, run), do: hd(Summary.list_rows(folder, run)).number

  @doc "Runs the set of a baseline again and compares; returns 1 if a metric is worse."
  @spec check_baseline(map(), keyword()) :: 0..255
  def check_baseline(%{file: file, dataset: path} = arguments, opts) do
    if opts[:bisect] == nil and (opts[:build] || opts[:copy] not in [nil, []]),
      do: throw({:usage, "--build and --copy need --bisect"})

    experiment = Loading.load_experiment!(file)
    found = find_baseline(opts[:baseline], experiment, path)

    if opts[:bisect],
      do: bisect_commits(arguments, found, opts),
      else: run_check(experiment, Error.unwrap!(Baseline.read_file(found)), path, opts)
  end

  # Without an option, the baseline is in the current folder, or it was promoted in the studio.
  defp find_baseline(nil, experiment, path) do
    name = experiment.module |> Module.split() |> List.last()
    experiments = Error.unwrap!(RunRecord.experiments_folder(path))
    promoted = Baseline.promoted_path(Path.join(experiments, name))

    if not File.exists?(@default_file) and File.exists?(promoted),
      do: promoted,
      else: @default_file
  end

  defp find_baseline(file, _experiment, _path), do: file

  defp bisect_commits(%{file: file, dataset: path}, baseline, opts) do
    _ = Error.unwrap!(Baseline.read_file(baseline))

    if opts[:cluster],
      do: throw({:usage, "--bisect runs here, because the nodes have one version of the code"})

    check = %{
      file: if(File.exists?(file), do: Path.expand(file), else: file),
      dataset: Path.expand(path),
      baseline: Path.expand(baseline),
      jobs: max(opts[:jobs], 1)
    }

    Bisecting.find_commit(check, opts[:bisect], opts)
  end

  defp run_check(experiment, baseline, path, opts) do
    dataset = Loading.open_dataset!(path)
    for name <- baseline["sessions"], do: Error.unwrap!(Dataset.session(dataset, name))

    settings = [
      jobs: max(opts[:jobs], 1),
      only: baseline["parameters"],
      sessions: &(&1.name in baseline["sessions"])
    ]

    case Running.run_interruptibly(experiment, dataset, settings, opts) do
      {:ok, result} -> report_check(baseline, dataset, result, opts)
      :interrupted -> 130
      {:error, error} -> raise error
    end
  end

  defp report_check(baseline, dataset, {folder, run}, opts) do
    [%{"number" => number}] = run["sets"]
    findings = Error.unwrap!(Baseline.check_run(baseline, folder, run, number))
    failed = for row <- Summary.list_rows(folder, run), failure <- row.failures, do: failure
    worse? = failed != [] or Enum.any?(findings, &(&1.status == :worse))
    recorded = record_differences(findings, baseline, dataset, {folder, run, number})

    if opts[:json],
      do:
        Output.print_json(%{
          ok: not worse?,
          metrics: Enum.map(findings, &finding_json/1),
          differences: Map.new(recorded),
          failed: Map.new(failed)
        }),
      else: print_check(findings, failed, recorded)

    if worse?, do: 1, else: 0
  end

  # The outputs of the baseline may be on another machine; the output is then compared with the truth alone. A
  # difference that cannot be recorded does not change the result of the check.
  defp record_differences(findings, baseline, dataset, {folder, _, _} = set) do
    sessions = for f <- findings, {session, _, _, _} <- f.sessions, uniq: true, do: session
    before = baseline_set(baseline, folder)

    for name <- Enum.take(sessions, @most_recordings),
        {:ok, session} <- [Dataset.session(dataset, name)],
        {:ok, %{path: path}} <- [record_difference(session, set, before)],
        do: {name, path}
  end

  defp record_difference(session, set, before) do
    with {:error, %Error{code: :no_output}} <-
           DifferenceFiles.ensure_recording(session, set, before),
         do: DifferenceFiles.ensure_recording(session, set, nil)
  end

  defp baseline_set(%{"run" => name, "set" => number}, folder) do
    runs = RunRecord.list_runs(Path.dirname(folder))

    with {_, run} <- Enum.find(runs, fn {at, run} -> at == folder and run["run"] == name end),
         do: {folder, run, number}
  end

  defp baseline_set(_baseline, _folder), do: nil

  defp print_check(findings, failed, recorded) do
    print_findings(findings, failed)

    for {session, path} <- recorded,
        do: Output.puts("The difference in #{session} is recorded: situ studio #{path}")
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

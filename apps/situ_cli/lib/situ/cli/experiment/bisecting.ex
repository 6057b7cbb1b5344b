defmodule Situ.CLI.Experiment.Bisecting do
  @moduledoc false
  # `situ experiment check --bisect GOOD`: finds the commit that made a metric fall. Each commit is checked out in a
  # worktree in a temporary folder, so the working tree of the user is not touched. A checkout of Situ itself is built
  # there and runs its own command line; any other repository is run with this one.
  # See docs/adr/0182-bisection-runs-every-commit-in-a-worktree.md.
  alias Situ.CLI.{Checkout, Interrupt, Output, Terminal}
  alias Situ.CLI.Experiment.Worktree
  alias Situ.{Error, TempFolder}
  alias Situ.Experiment.Bisection

  @interrupted 130

  @typedoc "The paths are absolute; `file` may also be the name of a module."
  @type check :: %{file: String.t(), dataset: Path.t(), baseline: Path.t(), jobs: pos_integer()}

  @doc "Runs the bisection. The status is 0 if the commit was found, and 1 if it may be one of several."
  @spec find_commit(check(), good :: String.t(), keyword()) :: 0 | 1 | 130
  def find_commit(check, good, opts) do
    repository = find_repository!(check.file)
    {good, commits} = list_commits!(repository, good)
    terminal = Terminal.open(opts)
    progress = %{counter: :counters.new(1, []), started: now_s()}
    state = %{check: check, repository: repository, terminal: terminal, opts: opts}
    search = &await_search(Map.put(state, :progress, progress), good, commits, &1)

    result =
      Interrupt.with_message(:interrupted, fn -> TempFolder.with_folder("bisect", search) end)

    Terminal.close(terminal)

    case result do
      {:ok, found} -> report_commits(repository, found, opts)
      {:error, error} -> raise error
      :interrupted -> @interrupted
    end
  end

  # An interrupted search leaves no worktree: the folder belongs to this process, which outlives the search.
  defp await_search(state, good, commits, folder) do
    task = Task.async(fn -> search_commits(state, good, commits, folder) end)
    ref = task.ref

    receive do
      {^ref, result} ->
        Process.demonitor(ref, [:flush])
        result

      :interrupted ->
        Task.shutdown(task, :brutal_kill)
        Worktree.remove_worktree(state.repository, folder)
        :interrupted
    end
  end

  # The range is checked first: otherwise, the result would be a wrong commit.
  defp search_commits(state, good, commits, folder) do
    Terminal.replace_line(state.terminal, "copying the build")
    worktree = Worktree.create_worktree(state.repository, folder, state.opts)
    test = &test_commit(state, worktree, &1, &2)

    # Two commits are tested in addition to the search.
    with {:latest, :bad} <- {:latest, test.(List.last(commits), 2 * length(commits))},
         {:good, :good} <- {:good, test.(good, length(commits))} do
      {:ok, Bisection.find_first_bad(commits, test)}
    else
      {:latest, verdict} -> {:error, latest_error(verdict)}
      {:good, verdict} -> {:error, good_error(good, verdict)}
    end
  rescue
    error in Error -> {:error, error}
  after
    Worktree.remove_worktree(state.repository, folder)
  end

  defp latest_error(:good) do
    range_error(
      "the latest commit is not worse than the baseline",
      "commit your changes first, because only commits are searched; or lower the tolerance in the baseline"
    )
  end

  defp latest_error(:untestable),
    do: range_error("the check fails at the latest commit", "run it without --bisect")

  defp good_error(good, :bad),
    do: range_error("#{good} is worse than the baseline, too", "name an older commit")

  defp good_error(good, :untestable),
    do: range_error("the check fails at #{good}", "name a later commit")

  defp range_error(why, fix) do
    Error.new(:no_range, "no commit can be found", why: why, fix: fix)
  end

  # `left` is the number of commits that may be the first bad one.
  defp test_commit(state, worktree, commit, left) do
    described = describe_commit(state.repository, commit)

    Terminal.replace_line(
      state.terminal,
      "checking #{described}#{estimate(state.progress, left)}"
    )

    started = now_s()
    {verdict, why} = check_commit(state, worktree, commit)
    :counters.add(state.progress.counter, 1, 1)
    Terminal.replace_line(state.terminal, "")

    unless state.opts[:json] do
      Output.puts("#{verdict_word(verdict)}  #{described}, #{format_seconds(now_s() - started)}")
      if why, do: Output.puts("            " <> Output.format_name(why))
    end

    verdict
  end

  # A search of n commits takes about log2(n) more steps, and this one.
  defp estimate(%{counter: counter, started: started}, left) do
    steps = max(Bisection.estimate_steps(left), 1)

    case :counters.get(counter, 1) do
      0 ->
        " (about #{Output.format_count(steps, "step")} left)"

      done ->
        seconds = (now_s() - started) / done * steps
        " (about #{Output.format_count(steps, "step")} left, #{format_seconds(seconds)})"
    end
  end

  defp now_s, do: System.monotonic_time(:millisecond) / 1000

  defp format_seconds(seconds) when seconds < 90, do: "#{round(seconds)} s"
  defp format_seconds(seconds), do: "#{round(seconds / 60)} min"

  defp verdict_word(:good), do: "good      "
  defp verdict_word(:bad), do: "worse     "
  defp verdict_word(:untestable), do: "skipped   "

  defp check_commit(state, worktree, commit) do
    case Worktree.build_commit(worktree, commit) do
      :ok -> run_check(state, worktree)
      {:error, why} -> {:untestable, "it does not build: " <> why}
    end
  end

  # Errors have the same status as a worse metric, but no report.
  defp run_check(%{check: check, repository: repository}, %{path: path} = worktree) do
    command =
      [find_command(path), "experiment", "check", file_in(path, repository, check.file)] ++
        [check.dataset, "--baseline", check.baseline, "--jobs", "#{check.jobs}", "--json"]

    {text, _status} = Worktree.run_logged(worktree, command)

    case Situ.JSON.decode(text) do
      {:ok, %{"ok" => true}} -> {:good, nil}
      {:ok, %{"ok" => false}} -> {:bad, nil}
      _ -> {:untestable, "the check fails: " <> Worktree.explain_failure(worktree, text)}
    end
  end

  defp find_command(path),
    do:
      if(Worktree.situ?(path), do: Path.join(path, "bin/situ"), else: Checkout.script_path("situ"))

  # A commit that does not have the experiment yet is checked with the current one.
  defp file_in(worktree, repository, file) do
    there = Path.join(worktree, Path.relative_to(file, repository))
    if script?(file) and File.exists?(there), do: there, else: file
  end

  defp script?(file), do: Path.extname(file) in [".ex", ".exs"]

  # Modules belong to Situ itself.
  defp find_repository!(file) do
    folder = if script?(file), do: Path.dirname(file), else: Checkout.folder()

    case Worktree.run_git(folder, ["rev-parse", "--show-toplevel"]) do
      {:ok, repository} ->
        repository

      {:error, why} ->
        raise Error.new(:no_repository, "#{folder} is not in a git repository",
                why: why,
                fix: "keep the experiment in the repository whose commits you want to search"
              )
    end
  end

  # A name such as HEAD~20 means another commit in the worktree, so only its hash is used.
  defp list_commits!(repository, name) do
    verify = ["rev-parse", "--verify", "--quiet", "--end-of-options", name <> "^{commit}"]

    with {:ok, good} <- Worktree.run_git(repository, verify),
         {:ok, text} <-
           Worktree.run_git(repository, [
             "rev-list",
             "--reverse",
             "--first-parent",
             good <> "..HEAD"
           ]),
         [_ | _] = commits <- String.split(text) do
      {good, commits}
    else
      _ ->
        raise Error.new(:no_commits, "there are no commits after #{inspect(name)}",
                why: "the search needs a commit that was good, and later ones",
                fix: "name a commit of #{repository}: --bisect HASH"
              )
    end
  end

  defp describe_commit(repository, commit) do
    case Worktree.run_git(repository, ["log", "-1", "--format=%h %s (%an, %as)", commit]) do
      {:ok, text} -> text
      {:error, _} -> commit
    end
  end

  defp report_commits(repository, found, opts) do
    described = Enum.map(found, &describe_commit(repository, &1))

    cond do
      opts[:json] ->
        Output.print_json(%{commits: found, described: described})

      match?([_], found) ->
        Output.puts("The metric fell with #{hd(described)}")

      true ->
        Output.puts(
          "The metric fell with one of these commits; those before the last one cannot be tested:"
        )

        for text <- described, do: Output.puts("  #{text}")
    end

    if match?([_], found), do: 0, else: 1
  end
end

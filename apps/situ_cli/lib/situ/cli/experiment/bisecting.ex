defmodule Situ.CLI.Experiment.Bisecting do
  @moduledoc false
  # `situ experiment check --bisect GOOD`: finds the commit that made a metric fall. Each commit is checked out in a
  # worktree in a temporary folder, so the working tree of the user is not touched. A checkout of Situ itself is built
  # there and runs its own command line; any other repository is run with this one.
  # See docs/adr/0182-bisection-runs-every-commit-in-a-worktree.md.
  alias Situ.CLI.{Checkout, Interrupt, Output, Terminal}
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
    state = %{check: check, repository: repository, terminal: terminal, opts: opts}
    search = &await_search(state, good, commits, &1)

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
        prune_worktrees(state.repository, worktree_path(folder))
        :interrupted
    end
  end

  # The range is checked first: otherwise, the result would be a wrong commit. Building a worktree of Situ takes
  # minutes, and a checkout without changes is the latest commit already.
  defp search_commits(state, good, commits, folder) do
    latest = List.last(commits)
    verdict = if unchanged?(state.repository), do: test_folder(state, state.repository, latest)

    if verdict in [:good, :untestable],
      do: {:error, latest_error(verdict)},
      else: search_worktree(state, {good, commits, verdict}, worktree_path(folder))
  end

  defp worktree_path(folder), do: Path.join(folder, "worktree")

  defp unchanged?(repository),
    do: run_git(repository, ["status", "--porcelain", "--untracked-files=no"]) == {:ok, ""}

  defp search_worktree(state, {good, commits, latest}, worktree) do
    run_git!(state.repository, ["worktree", "add", "--detach", worktree, good])
    test = &test_commit(state, worktree, &1)

    try do
      with {:latest, :bad} <- {:latest, latest || test.(List.last(commits))},
           {:good, :good} <- {:good, test.(good)} do
        {:ok, Bisection.find_first_bad(commits, test)}
      else
        {:latest, verdict} -> {:error, latest_error(verdict)}
        {:good, verdict} -> {:error, good_error(good, verdict)}
      end
    after
      prune_worktrees(state.repository, worktree)
    end
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

  defp prune_worktrees(repository, worktree) do
    run_git(repository, ["worktree", "remove", "--force", worktree])
    run_git(repository, ["worktree", "prune"])
  end

  defp test_commit(state, worktree, commit) do
    run_git!(worktree, ["checkout", "--detach", "--force", commit])
    test_folder(state, worktree, commit)
  end

  defp test_folder(state, folder, commit) do
    Terminal.replace_line(state.terminal, "checking #{describe_commit(state.repository, commit)}")
    verdict = run_check(state, folder)

    unless state.opts[:json],
      do: Output.puts("#{verdict_word(verdict)}  #{describe_commit(state.repository, commit)}")

    verdict
  end

  defp verdict_word(:good), do: "good      "
  defp verdict_word(:bad), do: "worse     "
  defp verdict_word(:untestable), do: "not tested"

  # Errors have the same status as a worse metric, but no report.
  defp run_check(%{check: check, repository: repository}, worktree) do
    arguments =
      ["experiment", "check", file_in(worktree, repository, check.file), check.dataset] ++
        ["--baseline", check.baseline, "--jobs", "#{check.jobs}", "--json"]

    {text, _status} =
      System.cmd(find_command(worktree), arguments, cd: worktree, env: [{"SITU_ROOT", nil}])

    case Situ.JSON.decode(text) do
      {:ok, %{"ok" => true}} -> :good
      {:ok, %{"ok" => false}} -> :bad
      _ -> :untestable
    end
  end

  defp find_command(worktree) do
    own = Path.join(worktree, "bin/situ")

    if File.exists?(own) and File.dir?(Path.join(worktree, "apps/situ_cli")),
      do: own,
      else: Checkout.script_path("situ")
  end

  # A commit that does not have the experiment yet is checked with the current one.
  defp file_in(worktree, repository, file) do
    there = Path.join(worktree, Path.relative_to(file, repository))
    if script?(file) and File.exists?(there), do: there, else: file
  end

  defp script?(file), do: Path.extname(file) in [".ex", ".exs"]

  # Modules belong to Situ itself.
  defp find_repository!(file) do
    folder = if script?(file), do: Path.dirname(file), else: Checkout.folder()

    case run_git(folder, ["rev-parse", "--show-toplevel"]) do
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

    with {:ok, good} <- run_git(repository, verify),
         {:ok, text} <-
           run_git(repository, ["rev-list", "--reverse", "--first-parent", good <> "..HEAD"]),
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
    case run_git(repository, ["log", "-1", "--format=%h %s (%an, %as)", commit]) do
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

  defp run_git!(folder, arguments) do
    with {:error, why} <- run_git(folder, arguments) do
      raise Error.new(:git_failed, "git #{Enum.join(arguments, " ")} failed",
              why: why,
              fix: "repair the repository"
            )
    end
  end

  defp run_git(folder, arguments) do
    case System.find_executable("git") do
      nil ->
        {:error, "git is not installed"}

      git ->
        case System.cmd(git, ["-C", folder | arguments], stderr_to_stdout: true) do
          {text, 0} -> {:ok, String.trim(text)}
          {text, _} -> {:error, String.trim(text)}
        end
    end
  end
end

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
    commits = list_commits!(repository, good)
    terminal = Terminal.open(opts)
    state = %{check: check, repository: repository, terminal: terminal, opts: opts}
    result = Interrupt.with_message(:interrupted, fn -> await_search(state, good, commits) end)
    Terminal.close(terminal)

    case result do
      {:ok, found} -> report_commits(repository, found, opts)
      {:error, error} -> raise error
      :interrupted -> @interrupted
    end
  end

  # The task ends with its temporary folder, so an interrupted search leaves no worktree.
  defp await_search(state, good, commits) do
    task =
      Task.async(fn ->
        TempFolder.with_folder("bisect", &search_commits(state, good, commits, &1))
      end)

    ref = task.ref

    receive do
      {^ref, result} ->
        Process.demonitor(ref, [:flush])
        result

      :interrupted ->
        Task.shutdown(task, :brutal_kill)
        prune_worktrees(state.repository)
        :interrupted
    end
  end

  # The range is checked first: otherwise, the result would be a wrong commit.
  defp search_commits(state, good, commits, folder) do
    worktree = Path.join(folder, "worktree")
    run_git!(state.repository, ["worktree", "add", "--detach", worktree, good])
    test = &test_commit(state, worktree, &1)

    try do
      case {test.(good), test.(List.last(commits))} do
        {:good, :bad} ->
          {:ok, Bisection.find_first_bad(commits, test)}

        {verdict, :bad} ->
          {:error, range_error("#{good} is #{describe_verdict(verdict)}", "name an older commit")}

        {_, verdict} ->
          {:error,
           range_error(
             "the latest commit is #{describe_verdict(verdict)}",
             "commit your changes first"
           )}
      end
    after
      prune_worktrees(state.repository, worktree)
    end
  end

  defp describe_verdict(:bad), do: "worse than the baseline, too"
  defp describe_verdict(:good), do: "not worse than the baseline"
  defp describe_verdict(:untestable), do: "not testable: the check fails there"

  defp range_error(why, fix) do
    Error.new(:no_range, "no commit can be found", why: why, fix: fix)
  end

  defp prune_worktrees(repository, worktree \\ nil) do
    if worktree, do: run_git(repository, ["worktree", "remove", "--force", worktree])
    run_git(repository, ["worktree", "prune"])
  end

  defp test_commit(state, worktree, commit) do
    Terminal.replace_line(state.terminal, "checking #{describe_commit(state.repository, commit)}")
    run_git!(worktree, ["checkout", "--detach", "--force", commit])
    verdict = run_check(state, worktree)

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

  defp list_commits!(repository, good) do
    with {:ok, _} <-
           run_git(repository, [
             "rev-parse",
             "--verify",
             "--quiet",
             "--end-of-options",
             good <> "^{commit}"
           ]),
         {:ok, text} <-
           run_git(repository, ["rev-list", "--reverse", "--first-parent", good <> "..HEAD"]),
         [_ | _] = commits <- String.split(text) do
      commits
    else
      _ ->
        raise Error.new(:no_commits, "there are no commits after #{inspect(good)}",
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

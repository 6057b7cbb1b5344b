defmodule Situ.CLI.Experiment.Worktree do
  @moduledoc false
  # A worktree in which the commits of a bisection are checked, one after the other. It starts as a copy of the user's
  # build, and unchanged files keep their times, so only the changes of a commit are built.
  # See docs/adr/0208-a-bisection-starts-from-the-users-build.md.
  alias Situ.Error

  @enforce_keys [:repository, :path, :log]
  defstruct [:repository, :path, :log, build: nil]

  @typedoc "`build` is the command that builds a commit; `log` is the file with the errors of the last command."
  @type t :: %__MODULE__{
          repository: Path.t(),
          path: Path.t(),
          log: Path.t(),
          build: [String.t()] | nil
        }

  # The results of bin/situ in a checkout of Situ. Mix's folders contain only links to priv.
  @built ~w(_build/prod .situ/setup-* apps/*/native/*/target apps/*/priv)
  @cargo_release "native/target/release"
  @cargo_target "CARGO_TARGET_DIR"

  # The standard input ends with the search, and with it every program that the command has started.
  @run_script """
  exec 3<&0 2>/dev/null
  setsid "$@" 2>"$SITU_BISECT_LOG" </dev/null 3<&- &
  job=$!
  { cat <&3; kill -s TERM -- -$job; } >/dev/null 2>&1 &
  watch=$!
  wait $job
  status=$?
  kill $watch
  exit $status
  """

  @doc """
  Creates the worktree in `folder` at the latest commit. `build:` is a command for a shell; `copy:` lists folders of the
  checkout that git ignores. A checkout of Situ needs neither.
  """
  @spec create_worktree(Path.t(), Path.t(), keyword()) :: t()
  def create_worktree(repository, folder, opts) do
    path = Path.join(folder, "worktree")
    run_git!(repository, ["worktree", "add", "--detach", path, "HEAD"])
    copied = copied_folders(repository, opts) ++ cargo_folders(repository)
    for {from, name} <- copied, do: copy_folder(from, Path.join(path, name))
    keep_times(repository, path)

    %__MODULE__{
      repository: repository,
      path: path,
      log: Path.join(folder, "errors.log"),
      build: build_command(path, opts[:build])
    }
  end

  @doc "Removes the worktree in `folder`, if it exists."
  @spec remove_worktree(Path.t(), Path.t()) :: :ok
  def remove_worktree(repository, folder) do
    _ = run_git(repository, ["worktree", "remove", "--force", Path.join(folder, "worktree")])
    _ = run_git(repository, ["worktree", "prune"])
    :ok
  end

  @doc "Checks a commit out and builds it. The error is the line that says why."
  @spec build_commit(t(), String.t()) :: :ok | {:error, String.t()}
  def build_commit(%{path: path} = worktree, commit) do
    run_git!(path, ["checkout", "--detach", "--force", commit])

    case worktree.build && run_logged(worktree, worktree.build) do
      nil -> :ok
      {_text, 0} -> :ok
      {text, _status} -> {:error, explain_failure(worktree, text)}
    end
  end

  @doc "Runs a command in the worktree and returns its standard output and status. Errors go to the log."
  @spec run_logged(t(), [String.t(), ...]) :: {String.t(), non_neg_integer()}
  def run_logged(%{path: path, log: log, repository: repository}, command) do
    env = [
      {"SITU_ROOT", nil},
      {"SITU_BISECT_LOG", log},
      {"SITU_BISECT_CHECKOUT", repository} | cargo_env(path)
    ]

    System.cmd("sh", ["-c", @run_script, "sh" | command], cd: path, env: env)
  end

  @doc "Returns the line that says why the last command failed: the first one with an error, or the last one."
  @spec explain_failure(t(), String.t()) :: String.t()
  def explain_failure(%{log: log}, output) do
    text =
      case File.read(log) do
        {:ok, text} -> output <> "\n" <> text
        {:error, _} -> output
      end

    lines = text |> String.chunk(:valid) |> Enum.filter(&String.valid?/1) |> Enum.join()

    lines =
      lines |> String.split(["\r", "\n"]) |> Enum.map(&String.trim/1) |> Enum.reject(&(&1 == ""))

    Enum.find(lines, &(&1 =~ ~r/error\b/i)) || List.last(lines) || "it printed nothing"
  end

  @doc "Says if a folder is a checkout of Situ, which is built and run by its own bin/situ."
  @spec situ?(Path.t()) :: boolean()
  def situ?(folder),
    do:
      File.exists?(Path.join(folder, "bin/situ")) and
        File.dir?(Path.join(folder, "apps/situ_cli"))

  @doc "Runs git in a folder."
  @spec run_git(Path.t(), [String.t()]) :: {:ok, String.t()} | {:error, String.t()}
  def run_git(folder, arguments) do
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

  defp run_git!(folder, arguments) do
    with {:error, why} <- run_git(folder, arguments) do
      raise Error.new(:git_failed, "git #{Enum.join(arguments, " ")} failed",
              why: why,
              fix: "repair the repository"
            )
    end
  end

  defp build_command(_path, command) when is_binary(command), do: ["sh", "-c", command]
  defp build_command(path, nil), do: if(situ?(path), do: ["bin/situ", "--version"])

  defp copied_folders(repository, opts) do
    own = if situ?(repository), do: Enum.flat_map(@built, &find_ignored(repository, &1)), else: []

    for name <- own ++ Enum.map(opts[:copy] || [], &check_folder!(repository, &1)),
        do: {Path.join(repository, name), name}
  end

  # Cargo may build outside of the checkout.
  defp cargo_folders(repository) do
    default = Path.join(repository, @cargo_release)

    release =
      if target = System.get_env(@cargo_target), do: Path.join(target, "release"), else: default

    if situ?(repository) and File.dir?(release), do: [{release, @cargo_release}], else: []
  end

  # The names of files and folders that git ignores.
  defp find_ignored(repository, pattern) do
    for path <- Path.wildcard(Path.join(repository, pattern), match_dot: true),
        folder = Path.relative_to(path, repository),
        {:ok, text} <- [run_git(repository, ignored(folder))],
        name <- String.split(text, <<0>>, trim: true),
        do:
          if(String.starts_with?(folder, name), do: folder, else: String.trim_trailing(name, "/"))
  end

  defp ignored(folder),
    do: ~w(ls-files -z --others --ignored --exclude-standard --directory --) ++ [folder]

  defp check_folder!(repository, name) do
    path = Path.expand(name, repository)
    relative = Path.relative_to(path, repository)

    if relative != path and File.dir?(path) and
         match?({:ok, _}, check_ignored(repository, relative)) do
      relative
    else
      raise Error.new(:not_copied, "#{name} cannot be copied to the commits",
              why: "it is not a folder of #{repository} that git ignores",
              fix: "name a folder with results of the build, such as --copy _build"
            )
    end
  end

  defp check_ignored(repository, name), do: run_git(repository, ["check-ignore", "--quiet", name])

  # A copy, not hard links: compilers overwrite some of their files in place. Where the file system can share blocks,
  # it does.
  defp copy_folder(from, to) do
    File.mkdir_p!(Path.dirname(to))

    with {text, status} when status != 0 <-
           System.cmd("cp", ["-a", from, to], stderr_to_stdout: true) do
      raise Error.new(:not_copied, "cannot copy #{from} to #{to}",
              why: String.trim(text),
              fix: "make space there, or set TMPDIR to a folder with more"
            )
    end
  end

  # A commit must not be built in the folder of the checkout: the checkout would later use libraries of an old
  # commit.
  defp cargo_env(path) do
    case System.get_env(@cargo_target) do
      nil -> []
      _folder -> [{@cargo_target, Path.join(path, "native/target")}]
    end
  end

  # Compilers compare times. A file that the user has changed gets a new time.
  defp keep_times(repository, path) do
    {:ok, text} = run_git(repository, ["ls-files", "-z"])

    {:ok, changed} = run_git(repository, ["diff", "--name-only", "--no-renames", "-z", "HEAD"])
    changed = MapSet.new(String.split(changed, <<0>>, trim: true))

    for name <- String.split(text, <<0>>, trim: true),
        name not in changed,
        {:ok, %{type: :regular, mtime: mtime}} <-
          [File.lstat(Path.join(repository, name), time: :posix)],
        do: File.touch(Path.join(path, name), mtime)

    # Otherwise, git would write the files again when it checks a commit out.
    _ = run_git(path, ["update-index", "-q", "--refresh"])
    :ok
  end
end

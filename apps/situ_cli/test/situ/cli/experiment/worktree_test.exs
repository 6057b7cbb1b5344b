defmodule Situ.CLI.Experiment.WorktreeTest do
  use ExUnit.Case, async: true
  alias Situ.CLI.Experiment.Worktree

  @moduletag :tmp_dir
  @moduletag timeout: 30_000

  setup %{tmp_dir: root} do
    repository = Path.join(root, "repository")
    folder = Path.join(root, "temporary")
    File.mkdir_p!(Path.join(repository, "models"))
    File.mkdir_p!(folder)
    git!(repository, ["init", "-q"])
    write!(repository, ".gitignore", "/models/\n")
    write!(repository, "old.txt", "old")
    write!(repository, "models/one", "trained")
    File.touch!(Path.join(repository, "old.txt"), 1_700_000_000)
    commit!(repository)
    on_exit(fn -> Worktree.remove_worktree(repository, folder) end)
    %{repository: repository, folder: folder}
  end

  test "it starts as a copy, and unchanged files keep their times", context do
    %{repository: repository, folder: folder} = context
    first = commit!(repository, "new.txt", "new")
    write!(repository, "new.txt", "changed by hand")
    File.touch!(Path.join(repository, "new.txt"), 1_700_000_000)

    worktree = Worktree.create_worktree(repository, folder, copy: ["models"], build: "true")
    assert :ok = Worktree.build_commit(worktree, first)
    assert File.read!(Path.join(worktree.path, "models/one")) == "trained"
    assert File.read!(Path.join(worktree.path, "new.txt")) == "new"
    assert time_of(worktree, "old.txt") == 1_700_000_000
    assert time_of(worktree, "new.txt") > 1_700_000_000

    second = commit!(repository, "later.txt", "later")
    assert :ok = Worktree.build_commit(worktree, second)
    assert time_of(worktree, "old.txt") == 1_700_000_000
  end

  test "only folders that git ignores are copied", context do
    %{repository: repository, folder: folder} = context
    File.mkdir_p!(Path.join(repository, "src"))

    for name <- ["src", "missing", "..", "/tmp"] do
      error =
        assert_raise Situ.Error, fn ->
          Worktree.create_worktree(repository, folder, copy: [name])
        end

      assert error.code == :not_copied
      Worktree.remove_worktree(repository, folder)
    end
  end

  test "a commit that does not build says why", %{repository: repository, folder: folder} do
    command = "echo compiling; printf 'x.c:1: error: no x\\nmake: stopped\\n' >&2; exit 3"
    worktree = Worktree.create_worktree(repository, folder, build: command)
    assert {:error, "x.c:1: error: no x"} = Worktree.build_commit(worktree, "HEAD")
    assert {"", 1} = Worktree.run_logged(worktree, ["false"])
    assert Worktree.explain_failure(worktree, "") == "it printed nothing"
  end

  test "the programs of a command end with the search", context do
    %{repository: repository, folder: folder} = context
    worktree = Worktree.create_worktree(repository, folder, [])
    ready = Path.join(folder, "ready")

    task =
      Task.async(fn ->
        Worktree.run_logged(worktree, ["sh", "-c", "sleep 600 & echo $! >#{ready}; wait"])
      end)

    pid = await_pid(ready)
    assert File.exists?("/proc/#{pid}")
    Task.shutdown(task, :brutal_kill)
    await_end(pid, 500)
  end

  defp await_pid(file) do
    case File.read(file) do
      {:ok, text} when text != "" -> String.trim(text)
      _ -> wait_and_then(fn -> await_pid(file) end)
    end
  end

  defp await_end(pid, 0), do: flunk("process #{pid} goes on")

  # A process that has ended may wait for its parent.
  defp await_end(pid, left) do
    case File.read("/proc/#{pid}/stat") do
      {:ok, text} ->
        if text =~ ") Z", do: :ok, else: wait_and_then(fn -> await_end(pid, left - 1) end)

      {:error, _} ->
        :ok
    end
  end

  defp wait_and_then(fun) do
    receive do
    after
      10 -> fun.()
    end
  end

  defp time_of(worktree, name),
    do: File.stat!(Path.join(worktree.path, name), time: :posix).mtime

  defp write!(folder, name, text), do: File.write!(Path.join(folder, name), text)

  defp commit!(repository, name, text) do
    write!(repository, name, text)
    commit!(repository)
  end

  defp commit!(repository) do
    git!(repository, ["add", "-A"])

    git!(
      repository,
      ~w(-c user.name=Test -c user.email=test@example.org commit -q -m) ++ ["A commit"]
    )

    git!(repository, ["rev-parse", "HEAD"])
  end

  defp git!(folder, arguments) do
    {text, 0} = System.cmd("git", ["-C", folder | arguments], stderr_to_stdout: true)
    String.trim(text)
  end
end

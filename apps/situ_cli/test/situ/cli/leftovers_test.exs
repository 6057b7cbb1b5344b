defmodule Situ.CLI.LeftoversTest do
  # A program of its own that is stopped while it makes a store and a file.
  use ExUnit.Case, async: true

  @moduletag :tmp_dir

  @program """
  [root] = System.argv()
  out = Path.join(root, "out")
  file = Path.join(root, "out.csv")
  :ok = Situ.CLI.Leftovers.remove_later(out)
  :ok = Situ.CLI.Leftovers.remove_file_later(file)
  File.write!(file <> ".unfinished", "half of it")

  Situ.Store.Draft.make({"out", root}, [], fn writer ->
    File.write!(Path.join(root, "draft"), writer.path)
    IO.puts("half way")
    Process.sleep(:infinity)
  end)
  """

  for signal <- ["INT", "KILL"] do
    test "nothing unfinished is left after SIG#{signal}, and nobody else's", %{tmp_dir: root} do
      # Of another program that is at work.
      other = Path.join(root, "out.4711-1.unfinished")
      File.mkdir_p!(other)
      {:ok, lock} = Situ.Store.FileLock.acquire(other <> ".lock")
      program = start(root)
      {:os_pid, pid} = Port.info(program, :os_pid)
      assert_receive {^program, {:data, "half way" <> _}}, 60_000
      draft = File.read!(Path.join(root, "draft"))
      assert File.dir?(draft) and File.exists?(draft <> ".lock")
      {_, 0} = System.cmd("kill", ["-#{unquote(signal)}", "#{pid}"])
      assert_receive {^program, {:exit_status, status}}, 60_000
      assert status != 0
      assert await_files(root, ["draft", Path.basename(other), Path.basename(other) <> ".lock"])
      Situ.Store.FileLock.release(lock)
    end
  end

  defp start(root) do
    paths = Enum.flat_map(:code.get_path(), &["-pa", List.to_string(&1)])
    elixir = System.find_executable("elixir")
    # `exec` all the way: the signal reaches the VM.
    args = ["--erl", "+Bd"] ++ paths ++ ["-e", @program, root]
    Port.open({:spawn_executable, elixir}, [:binary, :exit_status, args: args])
  end

  # The shell that removes them ends a moment after the program.
  defp await_files(root, expected) do
    if Enum.sort(File.ls!(root)) == Enum.sort(expected) do
      true
    else
      receive after: (20 -> await_files(root, expected))
    end
  end
end

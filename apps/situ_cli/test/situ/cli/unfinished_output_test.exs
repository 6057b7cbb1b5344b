defmodule Situ.CLI.UnfinishedOutputTest do
  # Stops another program while it writes a store and a file.
  use ExUnit.Case, async: true

  @moduletag :tmp_dir

  @program """
  [root] = System.argv()
  out = Path.join(root, "out")
  file = Path.join(root, "out.csv")
  :ok = Situ.CLI.UnfinishedOutput.remove_store_at_exit(out)
  :ok = Situ.CLI.UnfinishedOutput.remove_file_at_exit(file)
  File.write!(file <> ".unfinished", "half of it")

  Situ.Store.Draft.build_store({"out", root}, [], fn writer ->
    File.write!(Path.join(root, "draft"), writer.path)
    IO.puts("half way")
    receive do: (:never -> :ok)
  end)
  """

  for signal <- ["INT", "KILL"] do
    test "SIG#{signal} leaves nothing unfinished, except for other programs' drafts", %{
      tmp_dir: root
    } do
      # This draft belongs to another running program.
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
      # The shell that removes the drafts has the program's output and ends after it.
      assert_receive {^program, :eof}, 60_000
      left = ["draft", Path.basename(other), Path.basename(other) <> ".lock"]
      assert Enum.sort(File.ls!(root)) == Enum.sort(left)
      Situ.Store.FileLock.release(lock)
    end
  end

  defp start(root) do
    paths = Enum.flat_map(:code.get_path(), &["-pa", List.to_string(&1)])
    elixir = System.find_executable("elixir")
    # Everything uses `exec`, so the signal reaches the VM.
    args = ["--erl", "+Bd"] ++ paths ++ ["-e", @program, root]
    options = [:binary, :exit_status, :eof, :stderr_to_stdout, args: args]
    Port.open({:spawn_executable, elixir}, options)
  end
end

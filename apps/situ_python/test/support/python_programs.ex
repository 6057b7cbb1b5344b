defmodule Situ.PythonPrograms do
  @moduledoc false
  # Python programs for tests.

  @doc """
  Writes a program with one class `Part` in `folder`. `body` are the statements of its class.
  """
  def write_part(folder, body, imports \\ "") do
    path = Path.join(folder, "part.py")
    indented = body |> String.split("\n") |> Enum.map_join("\n", &("    " <> &1))

    File.write!(
      path,
      "import os, sys, time\nimport situ\n#{imports}\nclass Part(situ.Component):\n#{indented}\n"
    )

    path <> ":Part"
  end

  @doc "Returns an interpreter that has numpy."
  def numpy_python, do: System.get_env("SITU_TEST_PYTHON") || "/usr/bin/python3"

  @doc "Returns whether the interpreter has numpy."
  def numpy? do
    match?({_, 0}, System.cmd(numpy_python(), ["-c", "import numpy"], stderr_to_stdout: true))
  rescue
    ErlangError -> false
  end

  @doc "Waits until a process of the operating system has ended."
  def await_end(process) do
    {_, 0} = System.cmd("tail", ["--pid=#{process}", "-f", "/dev/null"])
    :ok
  end
end

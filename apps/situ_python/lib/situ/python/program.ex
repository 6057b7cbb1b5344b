defmodule Situ.Python.Program do
  @moduledoc false
  # Finds the interpreter and starts the worker program.
  alias Situ.Error
  alias Situ.Python.Package

  # Ends the worker, and the processes that it has started in its group, when the port closes: its owner or the VM has
  # ended, perhaps before the folder of the socket was removed. The worker has a socket for its data; its output is for
  # the log.
  @bound """
  exec 3<&0
  "$@" </dev/null 3<&- &
  pid=$!
  ( read -r _ <&3; rm -rf "$SITU_PYTHON_FOLDER"; kill -KILL $pid; kill -KILL -$pid ) >/dev/null 2>&1 &
  guard=$!
  exec 3<&-
  wait $pid
  status=$?
  kill -KILL -$pid 2>/dev/null
  kill $guard 2>/dev/null
  exit $status
  """
  @line_bytes 4_096
  # Python must not find modules in the current folder, which comes first by default.
  @start "import sys; sys.path[:] = filter(None, sys.path); import situ.worker; situ.worker.main(sys.argv[1])"

  @doc """
  Returns the path of an interpreter: a name that is searched for, the path of a program, or the folder of a virtual
  environment. Error: `:no_python`.

      iex> {:ok, path} = Situ.Python.Program.find_interpreter("python3")
      iex> Path.type(path)
      :absolute
      iex> {:error, error} = Situ.Python.Program.find_interpreter("no/such/python")
      iex> error.code
      :no_python
  """
  @spec find_interpreter(String.t()) :: {:ok, Path.t()} | {:error, Error.t()}
  def find_interpreter(python) do
    cond do
      File.dir?(python) -> find_in_folder(python)
      String.contains?(python, "/") -> check_program(Path.expand(python))
      path = System.find_executable(python) -> {:ok, path}
      true -> {:error, no_python(python, "PATH contains no program named #{python}")}
    end
  end

  defp find_in_folder(folder) do
    path = folder |> Path.join("bin/python") |> Path.expand()

    if File.regular?(path),
      do: {:ok, path},
      else:
        {:error,
         no_python(folder, "the folder is not a virtual environment: it has no bin/python")}
  end

  defp check_program(path) do
    if File.regular?(path),
      do: {:ok, path},
      else: {:error, no_python(path, "the file or folder does not exist")}
  end

  defp no_python(python, why) do
    Error.new(:no_python, "cannot find Python: #{python}",
      why: why,
      fix:
        "create the environment with python3 -m venv #{python}, or name another interpreter with python:"
    )
  end

  @doc "Checks that the file of a component exists; modules are found by Python. Error: `:no_python_file`."
  @spec check_source(String.t()) :: :ok | {:error, Error.t()}
  def check_source(source) do
    if not String.ends_with?(source, ".py") or File.regular?(source) do
      :ok
    else
      {:error,
       Error.new(:no_python_file, "the file #{source} does not exist",
         why: "relative paths start at #{File.cwd!()}",
         fix:
           "check the path, or write it as Path.join(__DIR__, #{inspect(Path.basename(source))})"
       )}
    end
  end

  @doc "Runs a function of `situ.worker` and returns its printed output."
  @spec call_function(Path.t(), String.t(), [String.t()]) :: {:ok, binary()} | {:error, binary()}
  def call_function(interpreter, function, args) do
    start =
      String.replace(
        @start,
        "situ.worker.main(sys.argv[1])",
        "situ.worker.#{function}(*sys.argv[1:])"
      )

    options = [env: [{"PYTHONPATH", to_string(search_path())}], stderr_to_stdout: true]

    case System.cmd(interpreter, ["-c", start | args], options) do
      {output, 0} -> {:ok, output}
      {output, _status} -> {:error, String.trim(output)}
    end
  end

  @doc """
  Starts the worker. The calling process receives its output as `{port, {:data, {:eol | :noeol, line}}}`, and
  `{port, {:exit_status, status}}`. It is killed when the port closes.
  """
  @spec start_worker(Path.t(), folder :: Path.t()) :: port()
  def start_worker(interpreter, folder) do
    Port.open({:spawn_executable, "/bin/sh"}, [
      :binary,
      :exit_status,
      :stderr_to_stdout,
      :hide,
      line: @line_bytes,
      env: [
        {~c"PYTHONPATH", search_path()},
        {~c"PYTHONUNBUFFERED", ~c"1"},
        {~c"SITU_PYTHON_FOLDER", to_charlist(folder)}
      ],
      args: ["-c", @bound, "situ-python", interpreter, "-c", @start, socket_path(folder)]
    ])
  end

  @doc "Returns the path of the socket to which the worker connects."
  @spec socket_path(folder :: Path.t()) :: Path.t()
  def socket_path(folder), do: Path.join(folder, "socket")

  defp search_path do
    [Package.folder() | List.wrap(System.get_env("PYTHONPATH"))]
    |> Enum.join(":")
    |> to_charlist()
  end

  @doc """
  Describes a worker: its process id, the version of Python, its memory, and its CPU time since the last description by
  the calling process, in percent of one core.
  """
  @spec describe_process(non_neg_integer(), String.t()) :: String.t()
  def describe_process(process, version) do
    now = {System.monotonic_time(:millisecond), read_cpu_ms(process)}
    before = Process.put({__MODULE__, process}, now)

    "process #{process}, Python #{version}, #{read_memory(process) || "?"} MB, " <>
      "#{cpu_share(before, now) || "?"} % CPU"
  end

  defp read_memory(process) do
    with {:ok, status} <- File.read("/proc/#{process}/status"),
         [_, kilobytes] <- Regex.run(~r/VmRSS:\s+(\d+)/, status) do
      div(String.to_integer(kilobytes), 1_000)
    else
      _ -> nil
    end
  end

  # The name of a program, in parentheses, may contain spaces. Fields 14 and 15 are ticks of 10 ms.
  defp read_cpu_ms(process) do
    with {:ok, stat} <- File.read("/proc/#{process}/stat"),
         fields = stat |> String.split(") ") |> List.last() |> String.split(),
         [user, system] <- Enum.slice(fields, 11, 2) do
      10 * (String.to_integer(user) + String.to_integer(system))
    else
      _ -> nil
    end
  end

  defp cpu_share({before, cpu_before}, {now, cpu}) when cpu_before != nil and cpu != nil,
    do: div(100 * (cpu - cpu_before), max(now - before, 1))

  defp cpu_share(_none, _now), do: nil

  @doc """
  Describes the end of a program by its exit status, as the shell reports it.

      iex> Situ.Python.Program.describe_status(139)
      "it was ended by signal 11 (segmentation fault)"
      iex> Situ.Python.Program.describe_status(3)
      "it ended with status 3"
  """
  @spec describe_status(non_neg_integer()) :: String.t()
  def describe_status(status) when status > 128 and status < 192 do
    names = %{
      6 => "abort",
      7 => "bus error",
      9 => "kill",
      11 => "segmentation fault",
      15 => "termination"
    }

    signal = status - 128
    name = if names[signal], do: " (#{names[signal]})", else: ""
    "it was ended by signal #{signal}#{name}"
  end

  def describe_status(status), do: "it ended with status #{status}"
end

defmodule Situ.Python.Environment do
  @moduledoc false
  # Virtual environments that are made from a list of packages. The name of an environment is the hash of the list and
  # of the interpreter, so each is made once and then shared by all programs of the user. It is made under another name
  # and renamed when it is complete.
  # See docs/adr/0178-environments-are-named-by-their-packages.md.
  alias Situ.Error
  alias Situ.Python.LogLines
  require Logger

  # Large packages take minutes on slow connections. Without any output for this long, ms, the program is stopped.
  @silence 600_000
  @line_bytes 4_096

  @type requirements :: Path.t() | [String.t()]
  @typedoc "`uv` is the path of this program, or nil. `folder` contains the environments. `log` takes lines of output."
  @type config :: %{uv: Path.t() | nil, folder: Path.t(), log: (String.t() -> any())}

  @doc "Returns the configuration of this machine. `path` names the component in the log."
  @spec default_config(String.t()) :: config()
  def default_config(path) do
    %{
      uv: System.find_executable("uv"),
      folder: System.get_env("SITU_PYTHON") || :filename.basedir(:user_cache, "situ/python"),
      log: &Logger.info([path, ": ", &1])
    }
  end

  @doc "Returns the interpreter of the environment for `requirements`, which is made if it does not exist yet."
  @spec find_or_create(requirements(), interpreter :: Path.t(), config()) ::
          {:ok, Path.t()} | {:error, Error.t()}
  def find_or_create(requirements, interpreter, config) do
    with {:ok, text} <- read_requirements(requirements),
         {:ok, version} <- read_version(interpreter) do
      folder = Path.join(config.folder, hash_name([text, 0, version, 0, interpreter]))

      # Components of this VM wait for one another. Programs that make the same environment do not.
      :global.trans({{__MODULE__, folder}, self()}, fn ->
        if File.dir?(folder),
          do: {:ok, interpreter_path(folder)},
          else: create(folder, {requirements, text}, interpreter, config)
      end)
    end
  end

  defp read_requirements(list) when is_list(list), do: {:ok, Enum.map_join(list, &[&1, "\n"])}

  defp read_requirements(path) do
    with {:error, reason} <- File.read(path) do
      {:error,
       Error.new(:no_python_file, "cannot read the requirements #{path}",
         why: "#{:file.format_error(reason)}; relative paths start at #{File.cwd!()}",
         fix: ~s|check the path, or list the packages: requirements: ["scikit-learn"]|
       )}
    end
  end

  # An interpreter that was upgraded needs new packages.
  defp read_version(interpreter) do
    {version, 0} = System.cmd(interpreter, ["-VV"], stderr_to_stdout: true)
    {:ok, version}
  rescue
    error in [ErlangError, MatchError] ->
      why = Exception.message(error)
      {:error, Error.new(:no_python, "#{interpreter} is not a Python interpreter", why: why)}
  end

  defp hash_name(data) do
    :crypto.hash(:sha256, data) |> Base.encode16(case: :lower) |> binary_part(0, 16)
  end

  defp interpreter_path(folder), do: Path.join(folder, "bin/python")

  defp create(folder, {requirements, text}, interpreter, config) do
    unfinished = "#{folder}.#{System.pid()}"
    File.rm_rf!(unfinished)
    File.mkdir_p!(config.folder)
    list = write_list(requirements, text, unfinished)
    config.log.("making a Python environment in #{folder}, once")

    result =
      with :ok <- run_steps(list_steps(config.uv, interpreter, unfinished, list), config),
           do: rename(unfinished, folder)

    _ = if is_list(requirements), do: File.rm(list)
    if result != :ok, do: File.rm_rf!(unfinished)
    with :ok <- result, do: {:ok, interpreter_path(folder)}
  rescue
    error in File.Error ->
      {:error, failed_error(Exception.message(error), "set SITU_PYTHON to a folder for them")}
  end

  # A file of requirements may name others relative to its folder.
  defp write_list(requirements, text, unfinished) when is_list(requirements) do
    list = unfinished <> ".txt"
    File.write!(list, text)
    list
  end

  defp write_list(path, _text, _unfinished), do: Path.expand(path)

  defp list_steps(nil, interpreter, folder, list) do
    pip = ["-m", "pip", "install", "--disable-pip-version-check", "--progress-bar", "off"]

    [
      {interpreter, ["-m", "venv", folder]},
      {interpreter_path(folder), pip ++ ["-r", list]}
    ]
  end

  defp list_steps(uv, interpreter, folder, list) do
    [
      {uv, ["venv", "--python", interpreter, folder]},
      {uv, ["pip", "install", "--python", interpreter_path(folder), "-r", list]}
    ]
  end

  defp run_steps([], _config), do: :ok

  defp run_steps([{program, args} | rest], config) do
    case run_program(program, args, config.log) do
      {0, _lines} -> run_steps(rest, config)
      {_status, lines} -> {:error, failed_error(lines, fix_failure(lines))}
    end
  end

  defp run_program(program, args, log) do
    options = [:binary, :exit_status, :stderr_to_stdout, :hide, line: @line_bytes, args: args]
    port = Port.open({:spawn_executable, program}, options)
    collect_lines(port, %LogLines{}, log)
  rescue
    error in ErlangError -> {127, "#{program}: #{Exception.message(error)}"}
  end

  defp collect_lines(port, lines, log) do
    receive do
      {^port, {:data, {_end, line}}} ->
        {entries, lines} = LogLines.add_line(lines, line, System.monotonic_time(:millisecond))
        for {_level, text} <- entries, do: log.(text)
        collect_lines(port, lines, log)

      {^port, {:exit_status, status}} ->
        {status, LogLines.last_lines(lines)}
    after
      @silence ->
        Port.close(port)
        {127, LogLines.last_lines(lines) <> "\nno output for #{div(@silence, 1000)} seconds"}
    end
  end

  defp rename(from, to) do
    case File.rename(from, to) do
      :ok -> :ok
      # Another program was faster.
      {:error, reason} when reason in [:eexist, :enotempty] -> discard(from)
      {:error, reason} -> {:error, failed_error(inspect(reason), nil)}
    end
  end

  defp discard(folder) do
    File.rm_rf!(folder)
    :ok
  end

  @offline ~r/connection|name resolution|timed out|unreachable|dns|failed to fetch|proxy/i
  @no_venv ~r/ensurepip|No module named (venv|pip)/

  defp fix_failure(lines) do
    cond do
      lines =~ @no_venv ->
        "install python3-venv or uv"

      lines =~ @offline ->
        "connect this machine to the package index for the first start, or name an existing environment with python:"

      true ->
        "correct the requirements, and check that this machine can reach the package index"
    end
  end

  defp failed_error(why, fix) do
    Error.new(:python_environment, "the Python environment cannot be made", why: why, fix: fix)
  end
end

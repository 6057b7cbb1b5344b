defmodule Situ.Bridge.Ros.Db3.Sqlite do
  @moduledoc false
  # Queries an SQLite database with the program `sqlite3`, in a separate process, and creates databases with it.
  alias Situ.Error

  @doc """
  Returns the rows that a query finds, as strings. Errors: `:not_bag` if the file is not an SQLite database,
  `:no_sqlite` if the program is not installed, and `:io` if the file cannot be read.
  """
  @spec query(Path.t(), String.t()) :: {:ok, [[String.t()]]} | {:error, Error.t()}
  def query(path, sql) do
    with {:ok, sqlite} <- find_program(), :ok <- check_file(path) do
      # Names do not contain the characters that separate columns and rows.
      args = [
        "-readonly",
        "-safe",
        "-batch",
        "-noheader",
        "-list",
        "-separator",
        "\x1f",
        "-newline",
        "\x1e"
      ]

      case System.cmd(sqlite, args ++ [Path.expand(path), sql], stderr_to_stdout: true) do
        {output, 0} ->
          {:ok,
           for(row <- String.split(output, "\x1e", trim: true), do: String.split(row, "\x1f"))}

        {output, _} ->
          {:error,
           Error.new(:not_bag, "#{path} cannot be read as a bag of ROS 2",
             why: shorten_output(output)
           )}
      end
    end
  end

  @typedoc "A running program that creates a database."
  @type session :: {port(), Path.t()}

  @doc "Starts the program with a new database; an existing file is replaced."
  @spec start_session(Path.t()) :: {:ok, session()} | {:error, Error.t()}
  def start_session(path) do
    with {:ok, sqlite} <- find_program(), :ok <- create_file(path) do
      port =
        Port.open({:spawn_executable, sqlite}, [
          :binary,
          :exit_status,
          :stderr_to_stdout,
          args: ["-safe", "-batch", "-bail", Path.expand(path)]
        ])

      {:ok, {port, path}}
    end
  end

  defp create_file(path) do
    with {:error, reason} <- File.write(path, ""),
         do:
           {:error,
            Error.new(:io, "cannot write #{path}", why: to_string(:file.format_error(reason)))}
  end

  @doc "Sends statements; waits while the program is busy. Errors are reported by `end_session/1`."
  @spec send_statements(session(), iodata()) :: :ok | {:error, Error.t()}
  def send_statements({port, path}, sql) do
    Port.command(port, sql)
    :ok
  rescue
    # The program has ended because of an error.
    ArgumentError -> {:error, collect_error(port, path)}
  end

  @doc "Waits until the program has executed all statements and ended."
  @spec end_session(session()) :: :ok | {:error, Error.t()}
  def end_session({port, path} = session) do
    with :ok <- send_statements(session, ".quit\n") do
      case await_exit(port, "") do
        {0, ""} -> :ok
        {_status, output} -> {:error, write_error(path, output)}
      end
    end
  end

  defp collect_error(port, path) do
    {_status, output} = await_exit(port, "")
    write_error(path, output)
  end

  defp await_exit(port, output) do
    receive do
      {^port, {:data, bytes}} -> await_exit(port, output <> bytes)
      {^port, {:exit_status, status}} -> {status, output}
    end
  end

  defp write_error(path, output),
    do: Error.new(:io, "cannot write #{path}", why: shorten_output(output))

  defp find_program do
    case System.find_executable("sqlite3") do
      nil ->
        {:error,
         Error.new(:no_sqlite, "the program sqlite3 is not installed", fix: "apt install sqlite3")}

      sqlite ->
        {:ok, sqlite}
    end
  end

  defp check_file(path) do
    case File.stat(path) do
      {:ok, %{type: :regular}} ->
        :ok

      {:ok, _} ->
        {:error, Error.new(:not_bag, "#{path} is not a file")}

      {:error, reason} ->
        {:error,
         Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))}
    end
  end

  defp shorten_output(output) do
    if String.valid?(output),
      do: output |> String.trim() |> String.slice(0, 200),
      else: "sqlite3 cannot read the file"
  end
end

defmodule Situ.Bridge.Ros.Db3.Sqlite do
  @moduledoc false
  # Queries an SQLite database with the program `sqlite3`, in a separate process.
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

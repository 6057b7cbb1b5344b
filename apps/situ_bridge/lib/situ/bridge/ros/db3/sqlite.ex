defmodule Situ.Bridge.Ros.Db3.Sqlite do
  @moduledoc false
  # Queries of a database by the program `sqlite3`, a process of its own.
  alias Situ.Error

  @doc """
  Returns the rows that a query finds, as texts. Error `:not_bag` for a file that is no such database, `:no_sqlite`
  without the program.
  """
  @spec query(Path.t(), String.t()) :: {:ok, [[String.t()]]} | {:error, Error.t()}
  # Columns and rows are separated by characters that no name has.
  def query(path, sql) do
    with {:ok, sqlite} <- sqlite(), :ok <- there(path) do
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
        {out, 0} ->
          {:ok, for(row <- String.split(out, "\x1e", trim: true), do: String.split(row, "\x1f"))}

        {out, _} ->
          {:error,
           Error.new(:not_bag, "#{path} cannot be read as a bag of ROS 2", why: text(out))}
      end
    end
  end

  defp sqlite do
    case System.find_executable("sqlite3") do
      nil ->
        {:error,
         Error.new(:no_sqlite, "the program sqlite3 is not installed", fix: "apt install sqlite3")}

      sqlite ->
        {:ok, sqlite}
    end
  end

  defp there(path) do
    case File.stat(path) do
      {:ok, %{type: :regular}} ->
        :ok

      {:ok, _} ->
        {:error, Error.new(:not_bag, "#{path} is no file")}

      {:error, reason} ->
        {:error,
         Error.new(:io, "cannot read #{path}", why: to_string(:file.format_error(reason)))}
    end
  end

  defp text(out),
    do:
      if(String.valid?(out),
        do: out |> String.trim() |> String.slice(0, 200),
        else: "sqlite3 refuses it"
      )
end

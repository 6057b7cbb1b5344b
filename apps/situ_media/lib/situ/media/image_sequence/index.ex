defmodule Situ.Media.ImageSequence.Index do
  @moduledoc false
  # The times of a folder of images: `times.csv`, with one line per file and its originating time in nanoseconds, such
  # as `000001.jpg,1700000000000000000`.
  alias Situ.Error

  @name "times.csv"
  @header "file,originating_time"

  @doc "Returns the path of a folder's index."
  @spec index_path(Path.t()) :: Path.t()
  def index_path(folder), do: Path.join(folder, @name)

  @doc false
  @spec header_line() :: String.t()
  def header_line, do: @header <> "\n"

  @doc false
  @spec format_line(String.t(), Situ.Time.t()) :: String.t()
  def format_line(file, time), do: "#{file},#{time}\n"

  @doc "Reads times and files. Times must strictly increase, and all files must be in the index's folder."
  @spec read_shots(Path.t()) :: {:ok, [{Situ.Time.t(), Path.t()}]} | {:error, Error.t()}
  def read_shots(path) do
    with {:ok, text} <- File.read(path),
         [@header | lines] <- text |> String.trim_trailing("\n") |> String.split("\n"),
         {:ok, [_ | _] = shots} <- parse_lines(lines, Path.dirname(path), []) do
      {:ok, shots}
    else
      {:error, %Error{} = error} -> {:error, error}
      {:error, reason} -> index_error(path, to_string(:file.format_error(reason)))
      {:ok, []} -> index_error(path, "the index contains no files")
      _ -> index_error(path, "its first line is not #{inspect(@header)}")
    end
  end

  defp parse_lines([], _folder, shots), do: {:ok, Enum.reverse(shots)}

  defp parse_lines([line | rest], folder, shots) do
    with [file, time] <- String.split(line, ","),
         # Only a plain name is allowed, because a path could leave the folder.
         true <- file != "" and Path.basename(file) == file,
         {time, ""} <- Integer.parse(time),
         true <- shots == [] or time > elem(hd(shots), 0) do
      parse_lines(rest, folder, [{time, Path.join(folder, file)} | shots])
    else
      _ ->
        index_error(
          Path.join(folder, @name),
          "line #{length(shots) + 2} is malformed: #{inspect(line)}"
        )
    end
  end

  defp index_error(path, why) do
    {:error,
     Error.new(:bad_index, "cannot read #{path}",
       why: why,
       fix: "correct it, or delete it to use rate:"
     )}
  end
end

defmodule Situ.Media.ImageSequence.Index do
  @moduledoc """
  The times of a folder of images: `times.csv`, with one line per file and its originating time in nanoseconds.

      file,originating_time
      000001.jpg,1700000000000000000
      000002.jpg,1700000000040000000
  """
  alias Situ.Error

  @name "times.csv"
  @header "file,originating_time"

  @doc "Returns the path of a folder's index."
  @spec path(Path.t()) :: Path.t()
  def path(folder), do: Path.join(folder, @name)

  @doc false
  @spec header() :: String.t()
  def header, do: @header <> "\n"

  @doc false
  @spec line(String.t(), Situ.Time.t()) :: String.t()
  def line(file, time), do: "#{file},#{time}\n"

  @doc "Reads times and files. Times must strictly increase, and all files must be in the index's folder."
  @spec read(Path.t()) :: {:ok, [{Situ.Time.t(), Path.t()}]} | {:error, Error.t()}
  def read(path) do
    with {:ok, text} <- File.read(path),
         [@header | lines] <- text |> String.trim_trailing("\n") |> String.split("\n"),
         {:ok, [_ | _] = shots} <- parse(lines, Path.dirname(path), []) do
      {:ok, shots}
    else
      {:error, %Error{} = error} -> {:error, error}
      {:error, reason} -> bad(path, to_string(:file.format_error(reason)))
      {:ok, []} -> bad(path, "the index contains no files")
      _ -> bad(path, "its first line is not #{inspect(@header)}")
    end
  end

  defp parse([], _folder, shots), do: {:ok, Enum.reverse(shots)}

  defp parse([line | rest], folder, shots) do
    with [file, time] <- String.split(line, ","),
         # Only a plain name is allowed, because a path could leave the folder.
         true <- file != "" and Path.basename(file) == file,
         {time, ""} <- Integer.parse(time),
         true <- shots == [] or time > elem(hd(shots), 0) do
      parse(rest, folder, [{time, Path.join(folder, file)} | shots])
    else
      _ ->
        bad(
          Path.join(folder, @name),
          "line #{length(shots) + 2} is malformed: #{inspect(line)}"
        )
    end
  end

  defp bad(path, why) do
    {:error,
     Error.new(:bad_index, "cannot read #{path}",
       why: why,
       fix: "correct it, or delete it to use rate:"
     )}
  end
end

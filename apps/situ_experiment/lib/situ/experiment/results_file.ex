defmodule Situ.Experiment.ResultsFile do
  @moduledoc false
  # The results of an experiment: one line of JSON for each finished session and set of parameters. A line is on disk
  # before the next result begins, so a killed run loses only the results that it was computing. If several lines have
  # the same key, the last one counts.
  # See docs/adr/0172-results-are-lines-of-json-next-to-the-dataset.md.
  alias Situ.{Error, JSON}
  alias Situ.Store.AtomicFile

  @type result :: %{String.t() => term()}

  @doc "Returns the path of the file in the experiment's folder."
  @spec file_path(Path.t()) :: Path.t()
  def file_path(folder), do: Path.join(folder, "results.jsonl")

  @doc "Reads all results by their keys. A line that a crash truncated is skipped."
  @spec read_results(Path.t()) :: %{String.t() => result()}
  def read_results(folder) do
    case File.read(file_path(folder)) do
      {:ok, text} ->
        for line <- String.split(text, "\n", trim: true),
            {:ok, %{"key" => key} = result} <- [JSON.decode(line)],
            into: %{},
            do: {key, result}

      {:error, _} ->
        %{}
    end
  end

  @doc "Appends a result and waits until it is on disk."
  @spec append_result(Path.t(), result()) :: :ok | {:error, Error.t()}
  def append_result(folder, result) do
    path = file_path(folder)

    # The leading line feed separates the line from a line that a crash truncated.
    with {:ok, device} <- :file.open(path, [:append, :raw, :binary]),
         :ok <- :file.write(device, ["\n", JSON.encode(result), "\n"]),
         :ok <- :file.datasync(device) do
      :file.close(device)
    else
      {:error, reason} -> {:error, write_error(path, reason)}
    end
  end

  @doc "Writes a file of JSON for people, completely or not at all."
  @spec write_json(Path.t(), JSON.value()) :: :ok | {:error, Error.t()}
  def write_json(path, value) do
    with :ok <- File.mkdir_p(Path.dirname(path)),
         :ok <- AtomicFile.write(path, JSON.encode_pretty(value) <> "\n") do
      :ok
    else
      {:error, reason} -> {:error, write_error(path, reason)}
    end
  end

  @doc "Returns the paths of the files and folders in a folder whose names have that ending, sorted."
  @spec list_files(Path.t(), String.t()) :: [Path.t()]
  def list_files(folder, ending) do
    case File.ls(folder) do
      {:ok, names} ->
        for name <- Enum.sort(names), String.ends_with?(name, ending), do: Path.join(folder, name)

      {:error, _} ->
        []
    end
  end

  @doc "Reads a file of JSON. Errors: `:not_found`, `:bad_json`."
  @spec read_json(Path.t()) :: {:ok, map()} | {:error, Error.t()}
  def read_json(path) do
    with {:ok, text} <- File.read(path), {:ok, %{} = value} <- JSON.decode(text) do
      {:ok, value}
    else
      {:error, reason} when reason != :bad_json ->
        {:error,
         Error.new(:not_found, "cannot read #{path}",
           why: to_string(:file.format_error(reason)),
           fix: "check the path"
         )}

      _ ->
        {:error, Error.new(:bad_json, "#{path} is not a JSON object", fix: "check the path")}
    end
  end

  defp write_error(path, reason) do
    Error.new(:not_saved, "cannot write #{path}",
      why: inspect(reason),
      fix: "free disk space, or check the folder"
    )
  end
end

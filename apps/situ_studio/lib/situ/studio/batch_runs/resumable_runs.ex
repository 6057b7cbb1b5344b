defmodule Situ.Studio.BatchRuns.ResumableRuns do
  @moduledoc false
  # Keeps track of batch runs that were interrupted because their studio stopped. A file next to
  # the dataset records how each run was started, until the run has finished. A page offers to
  # resume interrupted runs.
  @type t :: %{
          task: String.t(),
          output: String.t() | nil,
          sessions: [String.t()],
          config: map(),
          parallel: pos_integer()
        }

  @doc """
  Records the start of a run. If the file cannot be written, the run continues without a record.

      iex> file = Path.join(System.tmp_dir!(), "situ-doc-left.json")
      iex> run = %{task: "faces", output: "Faces", sessions: ["p1"], config: %{}}
      iex> Situ.Studio.BatchRuns.ResumableRuns.record_start(file, run)
      :ok
      iex> Situ.Studio.BatchRuns.ResumableRuns.list_interrupted(file)
      []
      iex> path = file <> ".Faces.batch"
      iex> File.write!(path, String.replace(File.read!(path), System.pid(), "999999999"))
      iex> [%{task: "faces", output: "Faces", sessions: ["p1"], config: %{}}] =
      ...>   Situ.Studio.BatchRuns.ResumableRuns.list_interrupted(file)
      iex> Situ.Studio.BatchRuns.ResumableRuns.delete_record(file, "Faces")
      iex> Situ.Studio.BatchRuns.ResumableRuns.list_interrupted(file)
      []
  """
  @spec record_start(Path.t(), map()) :: :ok
  def record_start(file, run) do
    text = run |> Map.put(:pid, System.pid()) |> Situ.JSON.encode()
    _ = File.write(record_path(file, run.output), text)
    :ok
  end

  @doc "Deletes the record of a run that has finished or was dismissed."
  @spec delete_record(Path.t(), String.t() | nil) :: :ok
  def delete_record(file, output) do
    _ = File.rm(record_path(file, output))
    :ok
  end

  @doc "Lists the runs whose studio is no longer running."
  @spec list_interrupted(Path.t()) :: [t()]
  def list_interrupted(file) do
    start = Path.basename(file) <> "."

    with {:ok, names} <- File.ls(Path.dirname(file)) do
      for name <- Enum.sort(names),
          String.starts_with?(name, start) and String.ends_with?(name, ".batch"),
          {:ok, text} <- [File.read(Path.join(Path.dirname(file), name))],
          {:ok, %{"task" => task, "sessions" => sessions, "pid" => pid} = run} <-
            [Situ.JSON.decode(text)],
          is_binary(task) and is_list(sessions) and is_binary(pid) and process_ended?(pid),
          do: %{
            task: task,
            output: run["output"],
            sessions: Enum.filter(sessions, &is_binary/1),
            config: if(is_map(run["config"]), do: run["config"], else: %{}),
            parallel: if(is_integer(run["parallel"]), do: max(run["parallel"], 1), else: 1)
          }
    else
      _ -> []
    end
  end

  # A run of this studio is still active and is listed as such.
  defp process_ended?(pid), do: pid != System.pid() and not File.exists?("/proc/" <> pid)

  defp record_path(file, output) do
    "#{file}.#{String.replace(output || "-", ~r/[^\w.-]/u, "_")}.batch"
  end
end

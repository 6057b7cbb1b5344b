defmodule Situ.Studio.BatchRuns.SavedOptions do
  @moduledoc false
  # Saves the options of batch tasks by name, as JSON files in one folder per task.
  alias Situ.Error

  @doc "Lists the saved configurations of a task, sorted by name. Unreadable files are skipped."
  @spec list_all(Path.t(), String.t()) :: [{String.t(), map()}]
  def list_all(folder, task) do
    for path <-
          folder |> task_folder(task) |> Path.join("*.json") |> Path.wildcard() |> Enum.sort(),
        {:ok, text} <- [File.read(path)],
        {:ok, %{} = config} <- [Situ.JSON.decode(text)],
        do: {path |> Path.basename(".json") |> URI.decode(), config}
  end

  @doc """
  Saves a configuration and replaces any other with the same name.

      iex> folder = Path.join(System.tmp_dir!(), "situ-doc-configurations")
      iex> Situ.Studio.BatchRuns.SavedOptions.save(folder, "loudness", "Room 1", %{"stream" => "Mic"})
      :ok
      iex> Situ.Studio.BatchRuns.SavedOptions.list_all(folder, "loudness")
      [{"Room 1", %{"stream" => "Mic"}}]
      iex> Situ.Studio.BatchRuns.SavedOptions.delete(folder, "loudness", "Room 1")
      iex> Situ.Studio.BatchRuns.SavedOptions.list_all(folder, "loudness")
      []
  """
  @spec save(Path.t(), String.t(), String.t(), map()) :: :ok | {:error, Error.t()}
  def save(folder, task, name, config) do
    with path = configuration_path(folder, task, name),
         :ok <- File.mkdir_p(Path.dirname(path)),
         :ok <- File.write(path, Situ.JSON.encode_pretty(config) <> "\n") do
      :ok
    else
      {:error, reason} ->
        {:error,
         Error.new(:not_saved, "the options cannot be saved",
           why: to_string(:file.format_error(reason))
         )}
    end
  end

  @doc "Deletes a configuration."
  @spec delete(Path.t(), String.t(), String.t()) :: :ok
  def delete(folder, task, name) do
    _ = File.rm(configuration_path(folder, task, name))
    :ok
  end

  defp task_folder(folder, task), do: Path.join([folder, "tasks", escape_name(task)])

  defp configuration_path(folder, task, name),
    do: Path.join(task_folder(folder, task), escape_name(name) <> ".json")

  defp escape_name(name),
    do: name |> String.slice(0, 60) |> URI.encode(&(URI.char_unreserved?(&1) and &1 != ?.))
end

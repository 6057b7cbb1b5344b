defmodule Situ.Studio.Experiments.DifferencePart do
  @moduledoc false
  # Finds the recording of the differences between two sets, which a page shows as another part of its session. The id
  # of the page is the session's id with `[EXPERIMENT:KEY]` in the place of a partition; names of partitions contain no
  # brackets.
  alias Situ.Dataset
  alias Situ.Experiment.{Difference, DifferenceFiles, RunRecord}

  @doc "Returns the name of the recording of the differences in the session."
  @spec part_name() :: String.t()
  def part_name, do: "Difference"

  @doc "Returns the last part of an item's id for a recording of differences."
  @spec encode_name(String.t()) :: String.t()
  def encode_name(name), do: "[#{name}]"

  @doc "Finds the recording of differences with that name, and its title."
  @spec fetch_recording(Dataset.t(), String.t()) :: {:ok, Path.t(), title :: String.t()} | :error
  def fetch_recording(%Dataset{file: file}, name) when is_binary(file) do
    with {:ok, experiments} <- RunRecord.experiments_folder(file),
         [_, name] <- Regex.run(~r/\A\[(.+)\]\z/, name),
         {:ok, path} <-
           DifferenceFiles.fetch_recording(experiments, name),
         {:ok, %{title: title}} <- Difference.describe_recording(path) do
      {:ok, path, title}
    else
      _ -> :error
    end
  end

  def fetch_recording(_dataset, _name), do: :error
end

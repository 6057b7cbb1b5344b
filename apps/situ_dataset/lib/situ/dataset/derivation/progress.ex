defmodule Situ.Dataset.Derivation.Progress do
  @moduledoc false
  # The progress of a run over sessions, which `Situ.Dataset.derive/3` describes.
  alias Situ.Pipeline

  defstruct weights: %{}, done: 0.0, finished: 0, total: 0, over: MapSet.new(), running: []

  @type t :: %__MODULE__{}

  @doc false
  @spec new([{String.t(), pos_integer()}], [String.t()]) :: t()
  def new(weights, kept) do
    progress = %__MODULE__{weights: Map.new(weights), total: length(weights)}
    Enum.reduce(kept, progress, &finish_session(&2, &1))
  end

  @doc false
  @spec finish_session(t(), String.t()) :: t()
  def finish_session(progress, name) do
    over = MapSet.put(progress.over, name)
    running = List.keydelete(progress.running, name, 0)
    update_running(%{progress | over: over, finished: MapSet.size(over)}, running)
  end

  @doc false
  @spec update_running(t(), [{String.t(), float()}]) :: t()
  def update_running(progress, running) do
    all = progress.weights |> Map.values() |> Enum.sum()
    over = progress.over |> Enum.map(&Map.get(progress.weights, &1, 0)) |> Enum.sum()

    part =
      running
      |> Enum.map(fn {name, f} -> f * Map.get(progress.weights, name, 0) end)
      |> Enum.sum()

    done = if all == 0, do: 1.0, else: (over + part) / all
    # The total must not decrease when a pipeline ends between two updates.
    %{progress | running: Enum.sort(running), done: max(progress.done, min(done, 1.0))}
  end

  @doc false
  # Closing and renaming the store after the pipeline counts for the last 5 %.
  @spec pipeline_fraction(Pipeline.t() | nil) :: float()
  def pipeline_fraction(nil), do: 0.0

  def pipeline_fraction(pipeline) do
    0.95 * Pipeline.progress(pipeline)
  rescue
    Situ.Error -> 0.95
  catch
    :exit, _ -> 0.95
  end
end

defmodule Situ.Studio.BatchRuns.Run do
  @moduledoc false
  # Holds the progress and the result of one run of a batch task over sessions of a dataset.
  alias Situ.Dataset.Derivation.Report

  @enforce_keys [:id, :file, :task, :began]
  defstruct [:id, :file, :task, :began, :ended, :output, :cancel, :error, :report] ++
              [status: :running, sessions: [], progress: %{done: 0.0, running: []}]

  @type t :: %__MODULE__{}

  # Below this share, an estimate of the remaining time is meaningless.
  @guess 0.02

  @doc """
  Updates the progress, as reported by `Situ.Dataset.derive/3`.

      iex> run = %Situ.Studio.BatchRuns.Run{id: 1, file: "study.json", task: "statistics", began: 0}
      iex> run = Situ.Studio.BatchRuns.Run.update_progress(run, %{done: 0.25})
      iex> {Situ.Studio.BatchRuns.Run.elapsed_ms(run, 10_000), Situ.Studio.BatchRuns.Run.remaining_ms(run, 10_000)}
      {10000, 30000}
      iex> Situ.Studio.BatchRuns.Run.remaining_ms(%{run | progress: %{done: 0.001}}, 10_000)
      nil
  """
  @spec update_progress(t(), map()) :: t()
  def update_progress(%__MODULE__{} = run, progress), do: %{run | progress: progress}

  @doc "Finishes the run with a report or the error that ended it."
  @spec finish(t(), {:ok, term(), Report.t()} | {:error, Situ.Error.t()}, integer()) :: t()
  def finish(%__MODULE__{} = run, {:ok, _, %Report{} = report}, now) do
    status =
      cond do
        report.cancelled? -> :cancelled
        Report.failures(report) != [] -> :failed
        true -> :done
      end

    %{run | status: status, report: report, ended: now}
  end

  def finish(%__MODULE__{} = run, {:error, error}, now),
    do: %{run | status: :failed, error: error, ended: now}

  @doc "Returns the elapsed time in ms. `now` is on the same clock as `began`."
  @spec elapsed_ms(t(), integer()) :: non_neg_integer()
  def elapsed_ms(%__MODULE__{} = run, now), do: max((run.ended || now) - run.began, 0)

  @doc "Estimates the remaining time in ms. Returns `nil` if it is too early for an estimate or the run has ended."
  @spec remaining_ms(t(), integer()) :: non_neg_integer() | nil
  def remaining_ms(%__MODULE__{status: :running, progress: %{done: done}} = run, now)
      when done >= @guess,
      do: round(elapsed_ms(run, now) * (1 - done) / done)

  def remaining_ms(_, _), do: nil
end

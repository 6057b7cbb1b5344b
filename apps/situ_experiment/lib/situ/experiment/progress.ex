defmodule Situ.Experiment.Progress do
  @moduledoc false
  # How far a run is, from its files: another program can show it while the run continues. Pure.
  alias Situ.Time

  @type t :: %{
          done: non_neg_integer(),
          failed: non_neg_integer(),
          total: non_neg_integer(),
          left_s: number() | nil
        }

  @doc """
  Returns the progress of a run at a time. Results that existed before the run count as done, but not for the estimate.

      iex> trials = for n <- 1..4, do: %{"set" => n, "session" => "p1", "key" => to_string(n), "metrics" => "m"}
      iex> run = %{"trials" => trials, "total" => 4, "kept" => 1, "started" => "2026-01-31T12:00:00Z"}
      iex> results = for n <- 1..2, into: %{}, do: {to_string(n), %{"metrics" => "m", "status" => "done"}}
      iex> {:ok, now} = Situ.Time.parse("2026-01-31T12:00:10Z")
      iex> Situ.Experiment.Progress.measure_progress(run, results, now)
      %{done: 2, failed: 0, left_s: 20.0, total: 4}
  """
  @spec measure_progress(map(), %{String.t() => map()}, Time.t()) :: t()
  def measure_progress(run, results, now) do
    finished =
      for %{"key" => key} = trial <- run["trials"],
          result = results[key],
          result["metrics"] == trial["metrics"],
          do: result["status"]

    done = length(finished)
    total = max(run["total"] || 0, length(run["trials"]))

    %{
      done: done,
      failed: Enum.count(finished, &(&1 == "failed")),
      total: total,
      left_s: estimate_left(run, done - (run["kept"] || 0), total - done, now)
    }
  end

  defp estimate_left(run, computed, left, now) do
    with true <- computed > 0 and left > 0,
         {:ok, started} <- Time.parse(run["started"]) do
      (now - started) / 1.0e9 / computed * left
    else
      _ -> nil
    end
  end
end

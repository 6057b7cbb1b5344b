defmodule Situ.Metric.MeasureTest do
  # Unloads a module, so nothing may use it at the same time.
  use ExUnit.Case, async: false
  alias Situ.Metric
  alias Situ.Metric.{RegressionScore, StoredMetric}

  test "a stored metric merges sessions in a program that has not used its module yet" do
    json = StoredMetric.to_json(:level, Metric.regression(truth: "Level.Truth"))

    sessions = [
      RegressionScore.sum_errors([{1.0, 1.0}, {2.0, 3.0}], 0),
      RegressionScore.sum_errors([{10.0, 12.0}, {14.0, 13.0}], 0)
    ]

    # The truths are 1, 2, 10 and 14, with squared deviations from their mean of 118.75 in total.
    unexplained = (0.0 + 1.0 + 4.0 + 1.0) / 118.75
    :code.purge(RegressionScore)
    true = :code.delete(RegressionScore)
    values = json |> StoredMetric.from_json() |> Metric.summarize(sessions)
    assert_in_delta values["r2"], 1 - unexplained, 1.0e-12
  end
end

defmodule Situ.Metric.RegressionScore do
  @moduledoc false
  # Compares numbers with the true ones.
  @behaviour Situ.Metric.Measure

  alias Situ.Metric.Ratio

  @impl true
  def directions,
    do: %{"mae" => :lower, "rmse" => :lower, "r2" => :higher, "missing" => :lower}

  @doc """
  Returns the sums of `[{truth, output}]`, and the number of true values without output.

  The variance of the true values is kept as mean and sum of squared deviations, which stays exact far from zero.

      iex> Situ.Metric.RegressionScore.sum_errors([{1.0, 1.5}, {3.0, 3.0}], 1)
      %{"n" => 2, "mean" => 2.0, "squares" => 2.0, "absolute" => 0.5, "squared" => 0.25, "missing" => 1}
  """
  @spec sum_errors([{number(), number()}], non_neg_integer()) :: %{String.t() => number()}
  def sum_errors(pairs, missing) do
    n = length(pairs)
    mean = if n == 0, do: 0.0, else: Enum.sum(for {truth, _} <- pairs, do: truth) / n

    %{
      "n" => n,
      "mean" => mean,
      "squares" => Enum.sum(for {truth, _} <- pairs, do: square(truth - mean)),
      "absolute" => Enum.sum(for {truth, output} <- pairs, do: abs(truth - output)),
      "squared" => Enum.sum(for {truth, output} <- pairs, do: square(truth - output)),
      "missing" => missing
    }
  end

  defp square(x), do: x * x

  # Combines means and squared deviations of two parts (T. F. Chan, G. H. Golub, R. J. LeVeque, 1979).
  @impl true
  def merge_counts(a, b) do
    n = a["n"] + b["n"]
    shift = b["mean"] - a["mean"]

    a
    |> Map.merge(b, fn _, x, y -> x + y end)
    |> Map.merge(%{
      "mean" => if(n == 0, do: 0.0, else: a["mean"] + shift * b["n"] / n),
      "squares" =>
        a["squares"] + b["squares"] +
          if(n == 0, do: 0.0, else: shift * shift * a["n"] * b["n"] / n)
    })
  end

  @impl true
  def compute_values(counts) do
    mse = Ratio.divide(counts["squared"], counts["n"])
    unexplained = Ratio.divide(counts["squared"], counts["squares"])

    %{
      "mae" => Ratio.divide(counts["absolute"], counts["n"]),
      "rmse" => mse && :math.sqrt(mse),
      "r2" => unexplained && 1.0 - unexplained,
      "missing" => Ratio.divide(counts["missing"], counts["n"] + counts["missing"])
    }
  end
end

defmodule Situ.Metric.Ratio do
  @moduledoc false
  # Divisions that metrics share. A quotient with the divisor 0 is undefined, which is `nil`.

  @doc """
  Divides `part` by `whole`.

      iex> {Situ.Metric.Ratio.divide(1, 4), Situ.Metric.Ratio.divide(1, 0)}
      {0.25, nil}
  """
  @spec divide(number(), number()) :: float() | nil
  def divide(_part, whole) when whole == 0, do: nil
  def divide(part, whole), do: part / whole

  @doc """
  Returns precision, recall and F1 of `matched` of `output` results and of `truth` true ones.

      iex> Situ.Metric.Ratio.f1_scores(2, 4, 2)
      %{"precision" => 0.5, "recall" => 1.0, "f1" => 2 / 3}
  """
  @spec f1_scores(number(), number(), number()) :: %{String.t() => float() | nil}
  def f1_scores(matched, output, truth) do
    %{
      "precision" => divide(matched, output),
      "recall" => divide(matched, truth),
      "f1" => divide(2 * matched, output + truth)
    }
  end
end

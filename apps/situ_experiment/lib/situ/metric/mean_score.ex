defmodule Situ.Metric.MeanScore do
  @moduledoc false
  # Values that are computed per session, such as the results of functions. The value of several sessions is the mean.
  # Each value is stored with the number of sessions that have one.
  @behaviour Situ.Metric.Measure

  alias Situ.Metric.Ratio

  @impl true
  def directions, do: %{}

  @doc """
  Returns the measurement of one session.

      iex> Situ.Metric.MeanScore.count_values(%{"p95_s" => 0.5, "max_s" => nil})
      %{"max_s" => 0, "n max_s" => 0, "p95_s" => 0.5, "n p95_s" => 1}
  """
  @spec count_values(%{String.t() => number() | nil}) :: %{String.t() => number()}
  def count_values(values) do
    for {name, value} <- values,
        {key, number} <- count_value(name, value),
        into: %{},
        do: {key, number}
  end

  defp count_value(name, nil), do: [{name, 0}, {"n " <> name, 0}]
  defp count_value(name, value), do: [{name, value}, {"n " <> name, 1}]

  @impl true
  def compute_values(counts) do
    for {"n " <> name, n} <- counts, into: %{}, do: {name, Ratio.divide(counts[name], n)}
  end
end

defmodule Smoother do
  # A module of the experiment's file, which nodes get as well.
  def mean(values), do: Enum.sum(values) / length(values)
end

defmodule Tune do
  use Situ.Experiment

  @impl true
  def parameters, do: [threshold: [0.3, 0.4, 0.5], smooth: [1, 3]]

  @impl true
  def build(_p, session, parameters) do
    %{level: level} = Situ.Experiment.cached(session, :smooth, n: parameters.smooth)
    %{"Speaking" => Situ.map(level, &(&1 > parameters.threshold), type: :boolean)}
  end

  # Each message takes some milliseconds, so a node can be killed in the middle.
  def smooth(session, %{n: n}) do
    level =
      session
      |> Situ.Experiment.stream("Level")
      |> Situ.scan([], fn x, last -> Enum.take([x | last], n) end)
      |> Situ.map(fn values -> values |> Smoother.mean() |> work() end, type: :float)

    %{level: level}
  end

  defp work(value) do
    Enum.each(1..200, fn n -> :crypto.hash(:sha256, <<n::8000>>) end)
    value
  end

  @impl true
  def metrics do
    [
      speaking: Situ.Metric.intervals(truth: "Speaking.Truth", main: :time_f1),
      cost: Situ.Metric.cost()
    ]
  end
end

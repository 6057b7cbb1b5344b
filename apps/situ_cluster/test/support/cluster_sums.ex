defmodule Situ.Test.ClusterSums do
  @moduledoc false
  # A pipeline for clusters: two sources, a join, a window and a running sum in three parts, and the rest.
  use Situ.Pipeline

  @impl true
  def build(p, opts) do
    n = Keyword.get(opts, :count, 2_000)
    numbers = Situ.sequence(p, 1, &rem(&1 * 7 + 1, 101), count: n, every: 1_000_000, name: "Left")

    others =
      Situ.sequence(p, 3, &rem(&1 * 5 + 2, 97),
        count: div(n * 2, 3),
        every: 1_500_000,
        name: "Right"
      )

    numbers
    |> Situ.composite("Sum", fn numbers ->
      numbers
      |> Situ.join(others, Situ.Reproducible.nearest(800_000))
      |> Situ.map(fn {a, b} -> a * 1_000 + b end)
      |> Situ.scan(0, &rem(&1 + &2, 1_000_003))
    end)
    |> Situ.composite("Smooth", &Situ.window(&1, -3..0, fn w -> Enum.sum(w) end))
    |> Situ.map(& &1, name: "Result")
  end
end

# The pipeline of the test: two sources, a join, a window, a running sum, and a component that
# draws random numbers, whose part is therefore not deterministic. Every node loads it.
defmodule Dice do
  use Situ.Component, inputs: [in: :any], outputs: [out: :any]

  def version, do: 1

  @impl true
  def init(_opts), do: {:ok, 0}

  # Each value refers to the previous one, so a part that continues from an older state breaks the
  # chain.
  @impl true
  def handle_message(:in, message, _context, sum) do
    drawn = :rand.uniform(1_000)
    {[{:out, message.originating_time, {message.data, drawn, sum + drawn}}], sum + drawn}
  end
end

defmodule Sums do
  use Situ.Pipeline

  @impl true
  def build(p, opts) do
    n = opts[:count]
    left = Situ.sequence(p, 1, &rem(&1 * 7 + 1, 101), count: n, every: 1_000_000, name: "Left")

    right =
      Situ.sequence(p, 3, &rem(&1 * 5 + 2, 97),
        count: div(n * 2, 3),
        every: 1_500_000,
        name: "Right"
      )

    sums =
      Situ.composite(left, "Sum", fn left ->
        left
        |> Situ.join(right, Situ.Reproducible.nearest(800_000))
        |> Situ.map(fn {a, b} -> a * 1_000 + b end)
        |> Situ.scan(0, &rem(&1 + &2, 1_000_003))
      end)

    smooth = Situ.composite(sums, "Smooth", &Situ.window(&1, -3..0, fn w -> Enum.sum(w) end))
    smooth |> Situ.via(Dice, name: "Dice") |> Situ.map(& &1, name: "Result")
    smooth
  end
end

# The pipeline that the nodes of test/nodes/run execute until they are killed.
defmodule Hall do
  use Situ.Pipeline

  def version, do: 1

  @impl true
  def build(p, opts) do
    steps =
      Situ.sequence(p, 1, &rem(&1 * 7, 101),
        count: 1_000_000,
        every: Situ.Time.ms(opts[:every] || 2),
        name: "Steps"
      )

    steps
    |> Situ.composite("Smooth", fn steps -> Situ.window(steps, -9..0, &Enum.sum/1) end)
    |> Situ.map(&(&1 / 10), name: "Mean")
  end
end

defmodule Situ.Test.ClusterRecorded do
  @moduledoc false
  # A pipeline for clusters that records in a separate part and in the part without a rule.
  use Situ.Pipeline

  @impl true
  def build(p, opts) do
    store = Situ.Store.create(p, "placed", opts[:root])
    other = Situ.Store.create(p, "unplaced", opts[:root])

    numbers =
      Situ.sequence(p, 1, &(&1 + 1), count: opts[:count], every: 1_000_000, name: "Numbers")

    Situ.composite(
      numbers,
      "Recording",
      &Situ.Store.write(Situ.map(&1, fn n -> n end), store, "numbers")
    )

    numbers |> Situ.map(&(&1 * 2)) |> Situ.Store.write(other, "doubles")
  end
end

defmodule Situ.Test.ClusterFan do
  @moduledoc false
  # A pipeline for clusters with a given number of parts, all of which read one source.
  use Situ.Pipeline

  @impl true
  def build(p, opts) do
    source = Situ.sequence(p, 1, &(&1 + 1), count: 10, every: 1_000_000, name: "Source")

    for i <- 1..opts[:parts],
        do: Situ.composite(source, "P#{i}", fn s -> Situ.map(s, &(&1 * i)) end)

    source
  end
end

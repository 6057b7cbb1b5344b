defmodule Situ.Stage.CountersTest do
  use ExUnit.Case, async: true
  alias Situ.Stage.Counters

  test "latencies of data as old as the epoch do not overflow" do
    ref = Counters.new()
    old = 1_800_000_000_000_000_000
    for _ <- 1..100, do: Counters.processed(ref, 1_000, old, 5)

    assert %{processed: 100_000, latency_last: ^old, latency_mean: 3_600_000_000_000} =
             Counters.read(ref)
  end

  test "mean and p99 of ordinary latencies" do
    ref = Counters.new()
    for latency <- [1_000_000, 3_000_000], do: Counters.processed(ref, 50, latency, 0)
    read = Counters.read(ref)
    assert read.latency_mean == 2_000_000
    assert read.latency_p99 >= 3_000_000 and read.latency_p99 <= 3_750_000
  end
end

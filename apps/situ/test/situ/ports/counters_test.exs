defmodule Situ.Ports.CountersTest do
  use ExUnit.Case, async: true
  alias Situ.Diagnostics.Averages
  alias Situ.Ports.Counters

  defp read(ref) do
    totals = Counters.read_totals(ref)
    ref |> Counters.read_values(totals) |> Map.merge(Averages.overall_means(totals))
  end

  test "latencies of data as old as the epoch do not overflow" do
    ref = Counters.new()
    old = 1_800_000_000_000_000_000
    for _ <- 1..100, do: Counters.count_emitted(ref, 1_000, -old, -old)
    for _ <- 1..100, do: Counters.count_processed(ref, 1_000, old, 5_000)
    hour = 3_600_000_000_000

    assert %{
             processed: 100_000,
             latency_last: ^old,
             latency_mean: ^hour,
             posted_last: posted,
             posted_mean: ahead,
             created_mean: ahead,
             handling_last: 5
           } = read(ref)

    assert {posted, ahead} == {-old, -hour}
  end

  test "computes the mean, last and p99 of ordinary latencies" do
    ref = Counters.new()
    Counters.count_emitted(ref, 75, 2_000, 3_000)
    Counters.count_emitted(ref, 25, 6_000, 7_000)

    for latency <- [1_000_000, 3_000_000],
        do: Counters.count_processed(ref, 50, latency, 50 * latency)

    read = read(ref)
    assert read.created_last == 6_000 and read.created_mean == 3_000
    assert read.posted_last == 7_000 and read.posted_mean == 4_000
    assert read.latency_last == 3_000_000 and read.latency_mean == 2_000_000
    assert read.handling_last == 3_000_000 and read.handling_mean == 2_000_000
    assert read.latency_p99 >= 3_000_000 and read.latency_p99 <= 3_750_000
  end

  test "the mean queue counts the messages left when a batch is taken" do
    ref = Counters.new()
    Counters.count_emitted(ref, 10, 0, 0)
    Counters.count_dropped(ref, 2)
    Counters.count_processed(ref, 2, 0, 0)
    Counters.count_processed(ref, 6, 0, 0)
    # Six messages were left after the first two, and none after the other six.
    assert %{queue: 0, queue_mean: mean} = read(ref)
    assert mean == 2 * 6 / 8
  end

  test "measures sizes of binaries, image data and other terms" do
    ref = Counters.new()
    picture = %{data: :binary.copy(<<0>>, 500), width: 20}
    term = {:some, "term"}

    Counters.count_sizes(ref, [<<1, 2, 3>>, picture, term])
    last = :erlang.external_size(term)
    assert %{size_last: ^last, size_mean: mean} = read(ref)
    assert mean == div(503 + last, 3)
  end
end

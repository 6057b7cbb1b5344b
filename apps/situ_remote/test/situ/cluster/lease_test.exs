defmodule Situ.Cluster.LeaseTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Cluster.Lease

  @times %{lease: 1_000, poll: 100, wait: 0}

  # Looks at these times (ms), each of which took no time, at a lease whose number is `seq`.
  defp looks(lease, seqs_and_times, times \\ @times) do
    Enum.reduce(seqs_and_times, {:wait, lease}, fn {seq, now}, {_, lease} ->
      Lease.observe(lease, {seq, "other@host", now, now}, times)
    end)
  end

  defp every(from, to, seq), do: for(now <- from..to//100, do: {seq, now})

  test "one that is written again and again is never free" do
    seen = for now <- 0..20_000//100, do: {1 + div(now, 300), now}

    Enum.reduce(seen, %Lease{}, fn {seq, now}, lease ->
      assert {:wait, lease} = Lease.observe(lease, {seq, "a", now, now}, @times)
      lease
    end)
  end

  test "one that stands still is free after its time, not before" do
    assert {:wait, _} = looks(%Lease{}, every(0, 900, 7))
    assert {:take, _} = looks(%Lease{}, every(0, 1_000, 7))
  end

  test "one that nobody ever had is free at once; a less preferred node waits" do
    assert {:take, _} = Lease.observe(%Lease{}, {0, nil, 5, 5}, @times)
    assert {:wait, lease} = Lease.observe(%Lease{}, {0, nil, 5, 5}, %{@times | wait: 500})
    assert {:take, _} = looks(lease, [{0, 105}, {0, 305}, {0, 505}], %{@times | wait: 500})
  end

  test "a look that comes late, or took long, says nothing about the owner" do
    {:wait, lease} = looks(%Lease{}, every(0, 500, 7))
    # Two seconds later: this process stood still itself.
    assert {:wait, lease} = Lease.observe(lease, {7, "a", 2_500, 2_500}, @times)
    # The log was away for two seconds.
    assert {:wait, lease} = Lease.observe(lease, {7, "a", 2_600, 4_600}, @times)
    assert {:wait, lease} = looks(lease, every(4_700, 5_500, 7))
    assert {:take, _} = looks(lease, [{7, 5_600}])
  end

  test "on a busy machine looks take long: their time does not count, and yet it comes to an end" do
    {:wait, lease} = looks(%Lease{}, [{7, 0}])

    {answer, took} =
      Enum.reduce_while(1..20, lease, fn i, lease ->
        case Lease.observe(lease, {7, "a", i * 500, i * 500 + 300}, @times) do
          {:take, _} -> {:halt, {:take, i * 500 + 300}}
          {:wait, lease} -> {:cont, lease}
        end
      end)

    assert answer == :take and took in 2_000..3_500
  end

  test "a node that is said to be down loses its lease at once, unless it writes it again" do
    {:wait, lease} = looks(%Lease{}, every(0, 200, 7))
    gone = Lease.down(lease, :other@host)
    assert {:take, _} = looks(gone, [{7, 250}])
    assert {:wait, _} = looks(gone, [{8, 250}])
    assert {:wait, _} = looks(Lease.down(lease, :third@host), [{7, 250}])
  end

  property "whatever is seen, it is not taken sooner than its time after the last change" do
    forall steps <- list({integer(0, 3), integer(1, 400)}) do
      {_, _, _, fine?} =
        Enum.reduce(steps, {%Lease{}, 0, {1, 0}, true}, fn {change, ms},
                                                           {lease, now, {seq, at}, fine?} ->
          now = now + ms
          {seq, at} = if change == 3, do: {seq + 1, now}, else: {seq, at}
          {answer, lease} = Lease.observe(lease, {seq, "a", now, now}, @times)
          {lease, now, {seq, at}, fine? and (answer == :wait or now - at >= 1_000)}
        end)

      fine?
    end
  end
end

defmodule Situ.Cluster.LeaseTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Cluster.Lease

  @times %{lease: 1_000, poll: 100, wait: 0}

  # Observes a lease with number `seq` at these times (ms); each observation takes no time.
  defp looks(lease, seqs_and_times, times \\ @times) do
    Enum.reduce(seqs_and_times, {:wait, lease}, fn {seq, now}, {_, lease} ->
      Lease.judge_reading(lease, {seq, "other@host", nil, {now, now}}, times)
    end)
  end

  defp every(from, to, seq), do: for(now <- from..to//100, do: {seq, now})

  test "a lease that is renewed is never free" do
    seen = for now <- 0..20_000//100, do: {1 + div(now, 300), now}

    Enum.reduce(seen, %Lease{}, fn {seq, now}, lease ->
      assert {:wait, lease} = Lease.judge_reading(lease, {seq, "a", nil, {now, now}}, @times)
      lease
    end)
  end

  test "a lease that does not change is free after its time, not before" do
    assert {:wait, _} = looks(%Lease{}, every(0, 900, 7))
    assert {:take, _} = looks(%Lease{}, every(0, 1_000, 7))
  end

  test "an unowned lease is free immediately, but a less preferred node waits" do
    assert {:take, _} = Lease.judge_reading(%Lease{}, {0, nil, nil, {5, 5}}, @times)

    assert {:wait, lease} =
             Lease.judge_reading(%Lease{}, {0, nil, nil, {5, 5}}, %{@times | wait: 500})

    assert {:take, _} = looks(lease, [{0, 105}, {0, 305}, {0, 505}], %{@times | wait: 500})
  end

  test "a late or slow observation says nothing about the owner" do
    {:wait, lease} = looks(%Lease{}, every(0, 500, 7))
    # Two seconds later: this process itself was paused.
    assert {:wait, lease} = Lease.judge_reading(lease, {7, "a", nil, {2_500, 2_500}}, @times)
    # The log was unavailable for two seconds.
    assert {:wait, lease} = Lease.judge_reading(lease, {7, "a", nil, {2_600, 4_600}}, @times)
    assert {:wait, lease} = looks(lease, every(4_700, 5_500, 7))
    assert {:take, _} = looks(lease, [{7, 5_600}])
  end

  test "on a busy machine slow observations do not count, but the wait still ends" do
    {:wait, lease} = looks(%Lease{}, [{7, 0}])

    {answer, took} =
      Enum.reduce_while(1..20, lease, fn i, lease ->
        case Lease.judge_reading(lease, {7, "a", nil, {i * 500, i * 500 + 300}}, @times) do
          {:take, _} -> {:halt, {:take, i * 500 + 300}}
          {:wait, lease} -> {:cont, lease}
        end
      end)

    assert answer == :take and took in 2_000..3_500
  end

  test "a lease whose node renews its own is never free, and free after its last renewal" do
    lease = %{key: "node_lease.c.a", session: "s1"}

    look = fn held, n, now ->
      Lease.judge_reading(held, {7, "a", {lease, n}, {now, now}}, @times)
    end

    held =
      for now <- 0..20_000//100, reduce: %Lease{} do
        held ->
          assert {:wait, held} = look.(held, div(now, 300), now)
          held
      end

    # The last renewal was seen at 19,800 ms.
    held =
      for now <- 20_100..20_700//100, reduce: held do
        held ->
          assert {:wait, held} = look.(held, 66, now)
          held
      end

    assert {:take, _} = look.(held, 66, 20_800)
    # A node that is reported down, but renews its lease, keeps its part.
    down = Lease.note_node_down(held, :a)
    assert {:take, _} = look.(down, 66, 20_750)
    assert {:wait, _} = look.(down, 67, 20_750)
  end

  test "a node reported down loses its lease immediately unless it renews it" do
    {:wait, lease} = looks(%Lease{}, every(0, 200, 7))
    gone = Lease.note_node_down(lease, :other@host)
    assert {:take, _} = looks(gone, [{7, 250}])
    assert {:wait, _} = looks(gone, [{8, 250}])
    assert {:wait, _} = looks(Lease.note_node_down(lease, :third@host), [{7, 250}])
  end

  property "is never taken sooner than its time after the last change" do
    forall steps <- list({integer(0, 3), integer(1, 400)}) do
      {_, _, _, fine?} =
        Enum.reduce(steps, {%Lease{}, 0, {1, 0}, true}, fn {change, ms},
                                                           {lease, now, {seq, at}, fine?} ->
          now = now + ms
          {seq, at} = if change == 3, do: {seq + 1, now}, else: {seq, at}
          {answer, lease} = Lease.judge_reading(lease, {seq, "a", nil, {now, now}}, @times)
          {lease, now, {seq, at}, fine? and (answer == :wait or now - at >= 1_000)}
        end)

      fine?
    end
  end
end

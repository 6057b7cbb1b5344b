defmodule Situ.Cluster.StandbyTest do
  use ExUnit.Case, async: true
  alias Situ.Cluster.Standby

  defp now, do: System.monotonic_time(:millisecond)
  # The lease lasts a minute. The tests read the timers without waiting for them.
  defp standby, do: Standby.new(60_000_000_000)
  defp lose_part(standby), do: Standby.resume_after_loss(standby)
  defp left(%{timer: timer}), do: Process.read_timer(timer)

  test "an owner that was heard from is not looked up in the log" do
    at = now()
    {:wait, standby} = Standby.judge_reading(standby(), {7, "other@host", nil, {at, at}}, 0)
    # It looks again after a tenth of the lease if it has heard nothing.
    assert left(Standby.schedule_next_check(standby)) <= 6_000
    standby = Standby.note_renewal(standby, 8, "other@host")
    assert left(standby) > 20_000

    # The lease began again when the owner was heard from, so the looks at the log count from there.
    at = now()

    assert {:wait, standby} =
             Standby.judge_reading(standby, {8, "other@host", nil, {at + 59_000, at + 59_000}}, 0)

    assert {:take, _} =
             Standby.judge_reading(standby, {8, "other@host", nil, {at + 60_001, at + 60_001}}, 0)
  end

  test "asks a slow log less often, but once per lease" do
    at = now()

    {:wait, standby} =
      Standby.judge_reading(standby(), {7, "other@host", nil, {at, at + 8_000}}, 0)

    assert left(Standby.schedule_next_check(standby)) in 25_000..32_000

    {:wait, standby} =
      Standby.judge_reading(standby, {7, "other@host", nil, {at, at + 50_000}}, 0)

    assert left(Standby.schedule_next_check(standby)) in 50_000..60_000
  end

  test "a node that repeatedly loses the part waits longer each time" do
    standby = standby() |> lose_part() |> lose_part() |> lose_part()
    at = now()
    {:wait, standby} = Standby.judge_reading(standby, {7, "", nil, {at, at}}, 0)

    assert {:wait, _} =
             Standby.judge_reading(standby, {7, "", nil, {at + 60_000, at + 60_000}}, 0)

    # A node that is given the part does not wait.
    standby = Standby.set_demotion(standby, 0, nil)

    assert {:take, _} =
             Standby.judge_reading(standby, {7, "", nil, {at + 60_000, at + 60_000}}, 0)
  end

  test "looks at the log as soon as the owner's node is lost" do
    at = now()
    {:wait, standby} = Standby.judge_reading(standby(), {7, "other@host", nil, {at, at}}, 0)
    standby = Standby.note_renewal(standby, 8, "other@host")
    assert left(Standby.note_node_down(standby, :third@host)) > 20_000
    _ = Standby.note_node_down(standby, :other@host)
    assert_receive :check
  end

  test "a temporary demotion ends with the process that asked for it" do
    mover = spawn(fn -> :ok end)
    standby = Standby.set_demotion(Standby.set_demotion(standby(), 2, nil), 5, mover)
    assert standby.demotion == 5
    assert_receive {:DOWN, ref, :process, ^mover, _}
    assert Standby.restore_demotion(standby, make_ref()).demotion == 5
    assert Standby.restore_demotion(standby, ref).demotion == 2
  end
end

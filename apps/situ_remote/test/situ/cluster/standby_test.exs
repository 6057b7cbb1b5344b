defmodule Situ.Cluster.StandbyTest do
  use ExUnit.Case, async: true
  alias Situ.Cluster.Standby

  defp now, do: System.monotonic_time(:millisecond)
  # The lease lasts a minute. The tests read the timers and wait for none of them.
  defp standby, do: Standby.new(60_000_000_000)
  defp lose_part(standby), do: Standby.resume_after_loss(standby)
  defp left(%{timer: timer}), do: Process.read_timer(timer)

  test "an owner that is heard of is not looked for in the log" do
    at = now()
    {:wait, standby} = Standby.observe(standby(), {7, "other@host", at, at}, 0)
    # It looks again after a tenth of the lease, as long as it has heard nothing.
    assert left(Standby.look_again(standby)) <= 6_000
    standby = Standby.hear(standby, 8, "other@host")
    assert left(standby) > 20_000
    # The lease began anew when the owner was heard, so the looks at the log count from there.
    at = now()

    assert {:wait, standby} =
             Standby.observe(standby, {8, "other@host", at + 59_000, at + 59_000}, 0)

    assert {:take, _} = Standby.observe(standby, {8, "other@host", at + 60_001, at + 60_001}, 0)
  end

  test "a log that takes its time is asked less often, but once in a lease" do
    at = now()
    {:wait, standby} = Standby.observe(standby(), {7, "other@host", at, at + 8_000}, 0)
    assert left(Standby.look_again(standby)) in 25_000..32_000
    {:wait, standby} = Standby.observe(standby, {7, "other@host", at, at + 50_000}, 0)
    assert left(Standby.look_again(standby)) in 50_000..60_000
  end

  test "a node that loses the part again and again waits longer each time" do
    standby = standby() |> lose_part() |> lose_part() |> lose_part()
    at = now()
    {:wait, standby} = Standby.observe(standby, {7, "", at, at}, 0)
    assert {:wait, _} = Standby.observe(standby, {7, "", at + 60_000, at + 60_000}, 0)
    # A node that is given the part does not wait.
    standby = Standby.lend(standby, 0, nil)
    assert {:take, _} = Standby.observe(standby, {7, "", at + 60_000, at + 60_000}, 0)
  end

  test "the log is looked at as soon as the owner's node is lost" do
    at = now()
    {:wait, standby} = Standby.observe(standby(), {7, "other@host", at, at}, 0)
    standby = Standby.hear(standby, 8, "other@host")
    assert left(Standby.down(standby, :third@host)) > 20_000
    _ = Standby.down(standby, :other@host)
    assert_receive :look
  end

  test "a loan ends with the process that asked for it" do
    mover = spawn(fn -> :ok end)
    standby = Standby.lend(Standby.lend(standby(), 2, nil), 5, mover)
    assert standby.away == 5
    assert_receive {:DOWN, ref, :process, ^mover, _}
    assert Standby.give_back(standby, make_ref()).away == 5
    assert Standby.give_back(standby, ref).away == 2
  end
end

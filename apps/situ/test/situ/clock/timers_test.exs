defmodule Situ.Clock.TimersTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Clock
  alias Situ.Clock.Timers

  property "timers come in the order of their times, those of one time in the order they were set" do
    forall times <- list(integer(0, 20)) do
      keyed = Enum.with_index(times)
      timers = Enum.reduce(keyed, %Timers{}, fn {time, i}, t -> Timers.add(t, time, i) end)
      {early, timers} = Timers.due(timers, 10)
      {late, timers} = Timers.due(timers, 20)
      expected = Enum.sort_by(keyed, &elem(&1, 0))
      assert early == for({time, i} <- expected, time <= 10, do: i)
      assert late == for({time, i} <- expected, time > 10, do: i)
      assert Timers.idle?(timers)
    end
  end

  test "one alarm, for what is due first; none while the clock stands still" do
    clock = Clock.manual(0)
    timers = Timers.add(Timers.add(%Timers{}, 5, :b), 3, :a)
    assert Timers.next_time(timers) == 3
    assert %{alarm: nil} = Timers.arm(timers, 3, clock)
    Clock.set(clock, 3)
    armed = Timers.arm(timers, 3, clock)
    assert_receive {:situ_alarm, 3}
    assert %{alarm: nil} = Timers.arm(armed, nil, clock)
  end

  test "what is later than the end is cut off" do
    timers = Enum.reduce(1..10, %Timers{}, &Timers.add(&2, &1, &1))
    assert {[1, 2, 3], rest} = timers |> Timers.cut(3) |> Timers.due(100)
    assert Timers.idle?(rest)
  end

  test "setting a timer does not cost more the more there are" do
    cost = fn n ->
      full = Enum.reduce(1..n, %Timers{}, &Timers.add(&2, &1, &1))
      {:reductions, before} = Process.info(self(), :reductions)
      Enum.reduce(1..1_000, full, &Timers.add(&2, n + &1, &1))
      {:reductions, later} = Process.info(self(), :reductions)
      later - before
    end

    assert cost.(20_000) < 5 * cost.(200)
  end
end

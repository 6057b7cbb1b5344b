defmodule Situ.Clock.TimersTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property

  alias Situ.Clock
  alias Situ.Clock.Timers

  property "timers fire in order of their times, and equal times in the order they were set" do
    forall times <- list(integer(0, 20)) do
      keyed = Enum.with_index(times)
      timers = Enum.reduce(keyed, %Timers{}, fn {time, i}, t -> Timers.add(t, time, i) end)
      {early, timers} = Timers.take_due(timers, 10)
      {late, timers} = Timers.take_due(timers, 20)
      expected = Enum.sort_by(keyed, &elem(&1, 0))
      assert early == for({time, i} <- expected, time <= 10, do: i)
      assert late == for({time, i} <- expected, time > 10, do: i)
      assert Timers.idle?(timers)
    end
  end

  test "sets one alarm for the earliest due timer, and none while the clock is stopped" do
    clock = Clock.manual(0)
    timers = Timers.add(Timers.add(%Timers{}, 5, :b), 3, :a)
    assert Timers.next_time(timers) == 3
    assert %{alarm: nil} = Timers.set_alarm(timers, 3, clock)
    Clock.set(clock, 3)
    armed = Timers.set_alarm(timers, 3, clock)
    assert_receive {:situ_alarm, 3}
    assert %{alarm: nil} = Timers.set_alarm(armed, nil, clock)
  end

  test "cuts off timers later than the end" do
    timers = Enum.reduce(1..10, %Timers{}, &Timers.add(&2, &1, &1))
    assert {[1, 2, 3], rest} = timers |> Timers.drop_after(3) |> Timers.take_due(100)
    assert Timers.idle?(rest)
  end

  test "the cost of setting a timer does not grow with the number of timers" do
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

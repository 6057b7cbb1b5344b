defmodule Situ.Clock.WallTest do
  use ExUnit.Case, async: true
  use Situ.Test.Property
  doctest Situ.Clock.Wall

  alias Situ.Clock.Wall

  @ms 1_000_000

  defp time({offset, floor}, counter), do: max(counter + offset, floor)

  property "time never goes back, whatever happens to the system time, and converges to it" do
    forall steps <- list({integer(1, 3_000), integer(-5_000, 5_000)}) do
      {_, _, line} =
        Enum.reduce(steps, {0, 0, {0, 0}}, fn {passes, jump}, {counter, ahead, line} ->
          {counter, ahead} = {counter + passes * @ms, ahead + jump * @ms}
          next = Wall.adjust_offset(line, counter, counter + ahead)
          assert time(next, counter) >= time(line, counter)
          {counter, ahead, next}
        end)

      # However far ahead the clock is, it agrees with the system time once that has caught up.
      {counter, ahead, ^line} =
        Enum.reduce(steps, {0, 0, line}, fn {p, j}, {c, a, l} -> {c + p * @ms, a + j * @ms, l} end)

      far = counter + 60_000_000 * @ms
      assert abs(time(line, far) - (far + ahead)) <= 100_000
    end
  end

  test "the keeper follows the system time, and clock readings never go back" do
    me = self()
    cells = Wall.new_cells({:os.perf_counter(), :os.system_time()})

    read = fn ->
      send(me, {:reading, self()})
      receive do: ({:ahead, ns} -> {:os.perf_counter(), :os.system_time() + ns})
    end

    {:ok, keeper} = Wall.start_link(cells: cells, read: read, every: 86_400_000)
    clock = %{Situ.Clock.real() | cells: cells}
    before = Situ.Clock.now(clock)
    look(keeper, 3_600_000 * @ms)
    ahead = Situ.Clock.now(clock)
    assert ahead - before >= 3_600_000 * @ms
    look(keeper, 0)
    assert Situ.Clock.now(clock) >= ahead
    # The clock now stays at this time for an hour.
    assert Situ.Clock.now(clock) == Situ.Clock.now(clock)
    look(keeper, 7_200_000 * @ms)
    assert Situ.Clock.now(clock) - ahead >= 3_599_000 * @ms
  end

  defp look(keeper, ns) do
    send(keeper, :look)
    assert_receive {:reading, ^keeper}, 30_000
    send(keeper, {:ahead, ns})
    :sys.get_state(keeper)
  end

  test "this node's time is the system time" do
    assert abs(Situ.Clock.now(Situ.Clock.real()) - :os.system_time()) < 1_000 * @ms
  end
end

defmodule Situ.Test.SlowestTestsTest do
  use ExUnit.Case, async: true

  import ExUnit.CaptureIO
  alias Situ.Test.SlowestTests

  doctest SlowestTests

  defp finished_test(time_us, name),
    do: %{time: time_us, module: __MODULE__, name: name, tags: %{file: __ENV__.file, line: 1}}

  test "prints at most ten tests that took a second or more, slowest first" do
    times_ms = [999, 1000, 7000] ++ Enum.map(1..12, &(&1 * 100 + 2000))

    {:ok, state} = SlowestTests.init([])

    state =
      Enum.reduce(times_ms, state, fn ms, state ->
        event = {:test_finished, finished_test(ms * 1000, :"test #{ms}")}
        {:noreply, state} = SlowestTests.handle_cast(event, state)
        state
      end)

    printed = capture_io(fn -> SlowestTests.handle_cast({:suite_finished, %{run: 1}}, state) end)

    lines = String.split(printed, "\n", trim: true)
    assert length(lines) == 10
    assert hd(lines) =~ "slow: 7.0 s  Situ.Test.SlowestTestsTest, test 7000"
    refute printed =~ "test 999"
  end

  test "names a test that does not end, and shows what its processes do" do
    me = self()
    stuck = spawn_link(fn -> wait(me) end)
    assert_receive :waiting

    {:noreply, state} =
      SlowestTests.handle_cast(
        {:test_started, finished_test(0, :"test stuck")},
        %{slow: [], running: %{}}
      )

    long_ago = fn {test, started_ms} -> {test, started_ms - 300_000} end
    late = update_in(state.running, &Map.new(&1, fn {key, run} -> {key, long_ago.(run)} end))

    assert capture_io(fn -> SlowestTests.handle_info(:check, state) end) == ""

    printed =
      capture_io(fn ->
        assert {:noreply, %{running: running}} = SlowestTests.handle_info(:check, late)
        assert running == %{}
      end)

    assert printed =~ "still running: Situ.Test.SlowestTestsTest, test stuck"
    assert printed =~ "#{inspect(stuck)}\n"
    assert printed =~ "SlowestTestsTest.wait/1"
  end

  defp wait(to) do
    send(to, :waiting)
    receive do: (:go -> to)
  end
end

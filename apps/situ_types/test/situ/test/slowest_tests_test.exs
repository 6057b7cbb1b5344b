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
end

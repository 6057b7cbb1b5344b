defmodule Situ.Test.SlowestTests do
  @moduledoc """
  An ExUnit formatter that prints the slowest tests of a suite, and the tests that don't end.

      mix test --formatter ExUnit.CLIFormatter --formatter Situ.Test.SlowestTests

  When a suite has finished, it prints a line for each of its ten slowest tests that took a second or longer:

      slow: 12.3 s  MyTest, test name (test/my_test.exs:7)

  `bin/test` collects these lines from all apps. `mix test --slowest` shows the same, but runs all tests in sequence.

  After five minutes, it also prints each test that is still running, and what the processes that run its module are
  doing. Some tests have no time limit, and nothing else would name the one that never ends.
  """
  use GenServer

  @count 10
  @at_least_us 1_000_000
  @check_every_ms 60_000
  @stuck_after_ms 300_000

  @impl true
  def init(_opts) do
    {:ok, _timer} = :timer.send_interval(@check_every_ms, :check)
    {:ok, %{slow: [], running: %{}}}
  end

  @impl true
  def handle_cast({:test_started, test}, state),
    do: {:noreply, put_in(state.running[key(test)], {test, now_ms()})}

  def handle_cast({:test_finished, test}, state) do
    slow = if test.time >= @at_least_us, do: [test | state.slow], else: state.slow
    {:noreply, %{state | slow: slow, running: Map.delete(state.running, key(test))}}
  end

  def handle_cast({:suite_finished, _times_us}, state) do
    state.slow |> take_slowest() |> Enum.each(&IO.puts(format_line(&1)))
    {:noreply, %{state | slow: [], running: %{}}}
  end

  def handle_cast(_event, state), do: {:noreply, state}

  @impl true
  def handle_info(:check, state) do
    now_ms = now_ms()

    stuck =
      for {key, {_test, started_ms}} <- state.running,
          now_ms - started_ms >= @stuck_after_ms,
          do: key

    for key <- stuck, {test, _started_ms} = state.running[key], do: IO.puts(format_stuck(test))
    {:noreply, %{state | running: Map.drop(state.running, stuck)}}
  end

  defp now_ms, do: System.monotonic_time(:millisecond)

  defp key(test), do: {test.module, test.name}

  @doc """
  Returns the lines that name a test that is still running, with the stack of each process that runs its module.
  """
  @spec format_stuck(map()) :: String.t()
  def format_stuck(%{module: module, name: name}) do
    stacks =
      for pid <- Process.list(),
          {:current_stacktrace, stack} <- [Process.info(pid, :current_stacktrace)],
          Enum.any?(stack, &(elem(&1, 0) == module)),
          do: "  #{inspect(pid)}\n#{Exception.format_stacktrace(stack)}"

    Enum.join(["still running: #{inspect(module)}, #{name}" | stacks], "\n")
  end

  @doc """
  Returns the ten slowest of `tests`, slowest first.

      iex> tests = [%{time: 1}, %{time: 3}, %{time: 2}]
      iex> Situ.Test.SlowestTests.take_slowest(tests)
      [%{time: 3}, %{time: 2}, %{time: 1}]
  """
  @spec take_slowest([map()]) :: [map()]
  def take_slowest(tests), do: tests |> Enum.sort_by(& &1.time, :desc) |> Enum.take(@count)

  @doc """
  Returns the line that `bin/test` collects for a test.

      iex> Situ.Test.SlowestTests.format_line(%{
      ...>   time: 2_340_000,
      ...>   module: MyTest,
      ...>   name: :"test it",
      ...>   tags: %{file: Path.expand("test/my_test.exs"), line: 7}
      ...> })
      "slow: 2.3 s  MyTest, test it (test/my_test.exs:7)"
  """
  @spec format_line(map()) :: String.t()
  def format_line(%{time: time_us, module: module, name: name, tags: tags}) do
    seconds = :erlang.float_to_binary(time_us / 1_000_000, decimals: 1)
    place = "#{Path.relative_to_cwd(tags.file)}:#{tags.line}"
    "slow: #{seconds} s  #{inspect(module)}, #{name} (#{place})"
  end
end

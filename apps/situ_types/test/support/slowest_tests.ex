defmodule Situ.Test.SlowestTests do
  @moduledoc """
  An ExUnit formatter that prints the slowest tests of a suite, without running them one by one.

      mix test --formatter ExUnit.CLIFormatter --formatter Situ.Test.SlowestTests

  When a suite has finished, it prints a line for each of its ten slowest tests that took a second or longer:

      slow: 12.3 s  MyTest, test name (test/my_test.exs:7)

  `bin/test` collects these lines from all apps. `mix test --slowest` shows the same, but runs all tests in sequence.
  """
  use GenServer

  @count 10
  @at_least_us 1_000_000

  @impl true
  def init(_opts), do: {:ok, []}

  @impl true
  def handle_cast({:test_finished, %{time: time_us} = test}, tests)
      when time_us >= @at_least_us,
      do: {:noreply, [test | tests]}

  def handle_cast({:suite_finished, _times_us}, tests) do
    tests |> take_slowest() |> Enum.each(&IO.puts(format_line(&1)))
    {:noreply, []}
  end

  def handle_cast(_event, tests), do: {:noreply, tests}

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

defmodule Situ.Stage.Load do
  @moduledoc false
  # Measures the load of a stage in a shared process, and decides when it needs a separate process. Pure.
  #
  # The time per message is the shortest of a few runs: on a busy machine, a run can take long because the system runs
  # other programs in between.
  alias Situ.Stage.{State, Work}

  @runs 4
  # From so much time per message on, a hop to another process costs less than a tenth of it.
  @heavy_ns 5_000
  # So much time per message delays the other stages noticeably, however few messages there are.
  @blocking_ns 500_000
  @long_run_ns 100_000_000
  @most_long_runs 3

  defstruct busy: 0, runs: 0, cost: 0, long_runs: 0

  @typedoc """
  `busy` is the time (ns) for which the stage ran since the last check, `runs` the number of runs since `cost`, the time
  (ns) per message, was measured. `long_runs` counts runs that kept other stages waiting for long.
  """
  @type t :: %__MODULE__{
          busy: non_neg_integer(),
          runs: non_neg_integer(),
          cost: non_neg_integer(),
          long_runs: non_neg_integer()
        }

  @doc "Adds a run of `elapsed` ns to the load of a stage, which has this state after it."
  @spec add_run(State.t(), integer()) :: State.t()
  def add_run(%State{load: load} = state, elapsed) do
    long_runs = if elapsed >= @long_run_ns, do: load.long_runs + 1, else: load.long_runs
    load = %{load | busy: load.busy + elapsed, runs: load.runs + 1, long_runs: long_runs}
    if load.runs < @runs, do: %{state | load: load}, else: measure_cost(%{state | load: load})
  end

  defp measure_cost(%{load: load} = state) do
    cost = state |> State.list_steps() |> Enum.map(&Work.shortest_time(&1.work)) |> Enum.sum()
    state = %{state | load: %{load | runs: 0, cost: cost}}
    State.map_steps(state, &%{&1 | work: Work.forget_shortest_time(&1.work)})
  end

  @doc "Returns whether the stage keeps others waiting."
  @spec blocking?(State.t()) :: boolean()
  def blocking?(%State{load: load}),
    do: load.cost >= @blocking_ns or load.long_runs >= @most_long_runs

  @doc "Returns whether a message of the stage takes so long that its own process costs little in comparison."
  @spec heavy?(State.t()) :: boolean()
  def heavy?(%State{load: load}), do: load.cost >= @heavy_ns

  @doc "Begins the next measurement of the busy time."
  @spec start_check(State.t()) :: State.t()
  def start_check(%State{load: load} = state), do: %{state | load: %{load | busy: 0}}
end

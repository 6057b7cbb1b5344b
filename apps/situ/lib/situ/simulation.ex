defmodule Situ.Simulation do
  @moduledoc """
  Runs pipelines under random but reproducible schedules, to find faults that depend on timing.

  A simulation runs a function, for example the body of a test, and everything that it starts: pipelines, their
  components, and the pipelines inside these. It is the same code as in production. Only one process runs at a time,
  and a seed decides which process takes its next message, when timers fire, how long callbacks seem to take, and,
  with `kill:`, when components die. Time is virtual and costs nothing. So a seed has one schedule, and a failure that
  occurs once in a million runs can be repeated as often as you like.

      iex> result = Situ.Simulation.run(fn ->
      ...>   Situ.to_list(fn p -> Situ.from_enumerable(p, 1..3, every: 1) |> Situ.map(&(&1 * 2)) end)
      ...> end, seed: 7)
      iex> result.value
      [2, 4, 6]

  `check/2` tries many seeds:

      iex> Situ.Simulation.check(fn ->
      ...>   [2, 4, 6] = Situ.to_list(fn p -> Situ.from_enumerable(p, 1..3, every: 1) |> Situ.map(&(&1 * 2)) end)
      ...> end, schedules: 20)
      :ok

  If the function raises, if all processes wait for each other, or if it does not end, `check/2` removes everything
  unusual from the schedule that the failure does not need. Then it raises a `Situ.Simulation.Failure`, with the steps
  of this schedule and the call that repeats it.

  ## Rules

  - The function must do the same in every run of a schedule. `:rand` and the system's time differ between runs; use
    `context.now`, and seed `:rand` inside the function.
  - Clocks must be created inside the function, because they take the time of the simulation.
  - Calls to processes outside the simulation (an `Agent`, a database) work. The simulation waits for their reply.
  - Processes that you spawn yourself are not simulated, except with `spawn_process/2`. The jobs of `Situ.map_async/3`
    are.
  - A `receive` with `after`, `Process.sleep/1` and `Process.send_after/3` wait for real time. Use timers of the
    pipeline (`{:timer, key, time}`, `Situ.timer/2`), which follow virtual time.
  - Log messages of simulated processes are dropped.

  The guide `docs/guides/simulation.md` shows how to test your pipelines.
  """
  alias Situ.{Options, Runtime}
  alias Situ.Simulation.{Choices, Failure, Result, Scheduler, Shrinker}

  @common [
    kill: [
      type: {:list, :string},
      default: [],
      doc:
        "Paths of components. The process of each dies at most once, at a step that the schedule chooses; a path " <>
          "that is listed twice dies at most twice."
    ],
    max_steps: [
      type: :pos_integer,
      default: 100_000,
      doc: "Turns after which a simulation counts as endless."
    ]
  ]

  @run [
    seed: [type: :integer, default: 0, doc: "The schedule."],
    choices: [
      type: {:optional, :any},
      doc: "The choices of a failure or of a result, to replay its schedule instead of a seed's."
    ]
  ]

  @check [
    schedules: [type: :pos_integer, default: 1_000, doc: "How many schedules to try."],
    seed: [type: :integer, default: 0, doc: "The seed of the first schedule; the others follow."],
    shrink: [
      type: :non_neg_integer,
      default: 1_000,
      doc: "How many schedules to try in order to shrink a failure."
    ]
  ]

  @doc """
  Runs `fun` under one schedule.

  #{Options.docs(@run ++ @common)}
  """
  @spec run((() -> term()), keyword()) :: Result.t()
  def run(fun, opts \\ []) when is_function(fun, 0) do
    opts = Options.validate!(opts, @run ++ @common)
    run_schedule(fun, Choices.new(opts[:choices] || opts[:seed]), opts, true)
  end

  @doc """
  Runs `fun` under many schedules; raises `Situ.Simulation.Failure` for the first that fails.

  #{Options.docs(@check ++ @common)}
  """
  @spec check((() -> term()), keyword()) :: :ok
  def check(fun, opts \\ []) when is_function(fun, 0) do
    opts = Options.validate!(opts, @check ++ @common)
    seeds = opts[:seed]..(opts[:seed] + opts[:schedules] - 1)

    Enum.reduce(seeds, Choices.new(0), fn seed, choices ->
      choices = Choices.new(seed, choices)
      result = run_schedule(fun, choices, opts, false)
      if result.failure, do: raise_shrunk(fun, choices, result, opts)
      choices
    end)

    :ok
  end

  @doc """
  Starts a process of the simulation, linked to the caller, for example to change a pipeline while the function does
  something else. `name` is its name in the steps. Outside a simulation it is an ordinary process.
  """
  @spec spawn_process(String.t(), (() -> term())) :: pid()
  def spawn_process(name, fun) when is_binary(name) and is_function(fun, 0),
    do: Runtime.spawn_process(:erlang, name, {:erlang, :apply, [fun, []]}, [:link])

  @spec raise_shrunk((() -> term()), Choices.t(), Result.t(), keyword()) :: no_return()
  defp raise_shrunk(fun, choices, %{failure: failure} = result, opts) do
    fails? = fn deviations ->
      again = run_schedule(fun, Choices.new(deviations, choices), opts, false)
      again.failure != nil and failure_key(again.failure) == failure_key(failure)
    end

    shrunk = Shrinker.shrink_deviations(result.choices, opts[:shrink], fails?)
    shown = run_schedule(fun, Choices.new(shrunk, choices), opts, true)
    raise_failure(shown, failure, shrunk)
  end

  # A function that depends on more than the schedule may not fail again.
  defp raise_failure(%{failure: nil}, failure, _shrunk), do: raise(failure)

  defp raise_failure(%{failure: shown} = result, failure, shrunk),
    do: raise(%{shown | seed: failure.seed, choices: shrunk, result: %{result | failure: nil}})

  # Schedules that fail in the same way.
  defp failure_key(%{kind: :raised, how: how, reason: %Situ.Error{code: code}}), do: {how, code}
  defp failure_key(%{kind: :raised, how: how, reason: %module{}}), do: {how, module}
  defp failure_key(%{kind: kind, how: how}), do: {kind, how}

  # A new process has no other messages.
  defp run_schedule(fun, choices, opts, trace?) do
    settings = %{kill: opts[:kill], max_steps: opts[:max_steps], trace?: trace?}
    simulate = fn -> exit({:simulated, Scheduler.run_simulation(fun, choices, settings)}) end
    {pid, monitor} = spawn_monitor(simulate)

    receive do
      {:DOWN, ^monitor, :process, ^pid, {:simulated, run}} -> build_result(run, choices.seed)
      {:DOWN, ^monitor, :process, ^pid, reason} -> exit(reason)
    end
  end

  defp build_result(run, seed) do
    {value, failure} = read_outcome(run.outcome)

    %Result{
      value: value,
      failure: failure && %{failure | seed: seed, choices: run.choices},
      steps: run.trace,
      choices: run.choices,
      turns: run.turns,
      time: run.time
    }
  end

  defp read_outcome({:returned, value}), do: {value, nil}

  defp read_outcome({:raised, how, reason, stack}) do
    reason = if how == :error, do: Exception.normalize(:error, reason, stack), else: reason
    {nil, %Failure{kind: :raised, how: how, reason: reason, stacktrace: stack}}
  end

  defp read_outcome({kind, processes}), do: {nil, %Failure{kind: kind, processes: processes}}
end

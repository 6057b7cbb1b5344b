defmodule Situ.Simulation.Scheduler do
  @moduledoc false
  # The process that runs a simulation: it grants one process at a time a turn, and the choices decide which. A process
  # can take a turn when it is new, when it rests and its mailbox has a message, or when it waits in the middle of a
  # turn and a message has arrived since. Timers fire when nothing else can run, and sometimes earlier; virtual time
  # then jumps to theirs.
  alias Situ.Simulation.{Choices, Processes, Shell, Timers, Trace}

  # Virtual time at the start (2020-01-01), and how much a turn takes at least, ns.
  @start_time 1_577_836_800_000_000_000
  @turn_ns 1_000
  # A timer fires although processes can run, or a process is killed, once in about so many turns.
  @early_odds 24
  @early_ns 50_000_000
  @kill_odds 32
  # Turns after the function has returned, for processes that are about to end.
  @most_after 10_000
  # How often, and at which interval, processes that may wait for something else than a message run again.
  @retries 20
  @retry_ms 10
  # A turn that takes this long (of real time) does not end.
  @longest_turn_us 30_000_000

  @enforce_keys [:shared, :processes, :max_steps]
  defstruct [
    :shared,
    :processes,
    :max_steps,
    timers: %Timers{},
    kills: [],
    step: 0,
    client: nil,
    outcome: nil,
    deviations: 0,
    trace: []
  ]

  @typedoc "`kills` lists the labels of processes that are still to be killed."
  @type t :: %__MODULE__{}
  @type outcome ::
          {:returned, term()}
          | {:raised, :error | :exit | :throw, term(), list()}
          | {:deadlock, [{String.t(), String.t()}]}
          | {:endless, [{String.t(), String.t()}]}

  @doc "Runs `fun` in a simulated process until it returns; needs a process without other messages."
  @spec run_simulation((() -> term()), Choices.t(), map()) :: map()
  def run_simulation(fun, choices, settings) do
    time = :atomics.new(1, signed: true)
    :atomics.put(time, 1, @start_time)

    shared = %Shell{
      ref: make_ref(),
      scheduler: self(),
      time: time,
      choices: choices,
      traced?: settings.trace?
    }

    state = %__MODULE__{
      shared: shared,
      processes: %Processes{},
      max_steps: settings.max_steps,
      kills: Enum.sort(settings.kill)
    }

    client =
      Shell.spawn_process(shared, :erlang, "test", {{__MODULE__, :run_client, [shared, fun]}, []})

    %{state | client: client} |> receive_report(:over) |> loop() |> finish()
  end

  @doc false
  def run_client(%{ref: ref, scheduler: scheduler}, fun) do
    outcome =
      try do
        {:returned, fun.()}
      catch
        kind, reason -> {:raised, kind, reason, __STACKTRACE__}
      end

    send(scheduler, {ref, :outcome, outcome})
  end

  defp loop(%{step: step, max_steps: most, outcome: nil} = state) when step >= most,
    do: %{state | outcome: {:endless, Processes.describe_all(state.processes)}}

  defp loop(%{outcome: nil} = state) do
    {runnable, state} = list_runnable(state)

    cond do
      runnable != [] -> state |> choose_turn(runnable) |> loop()
      Timers.waiting?(state.timers) -> state |> fire_timer() |> loop()
      await_outside(state) -> loop(state)
      true -> retry_waiting(state, @retries)
    end
  end

  defp loop(state), do: state

  # A function such as `Process.info/2` may wait for another process without a message, and a suspended process would
  # wait forever. So before all count as deadlocked, these run again, for some real time: the answer may come from a
  # process outside the simulation.
  defp retry_waiting(%{outcome: nil} = state, retries) do
    {runnable, state} = list_runnable(state)
    waiting = Processes.list_retriable(state.processes)

    cond do
      runnable != [] or Timers.waiting?(state.timers) ->
        loop(state)

      waiting == [] or retries == 0 ->
        %{state | outcome: {:deadlock, Processes.describe_all(state.processes)}}

      true ->
        waiting |> Enum.reduce(state, &retry_turn/2) |> retry_waiting(retries - 1)
    end
  end

  defp retry_waiting(state, _retries), do: state

  defp retry_turn(pid, %{outcome: nil} = state) do
    if Processes.member?(state.processes, pid) do
      {kind, processes} = Processes.grant_turn(state.processes, pid, state.shared.ref)
      Process.sleep(@retry_ms)
      began = System.monotonic_time(:microsecond)
      receive_report(%{state | processes: processes}, {pid, kind, began})
    else
      state
    end
  end

  defp retry_turn(_pid, state), do: state

  # Ends the processes that are left. Most of them are ending by themselves.
  defp finish(%{outcome: outcome} = state) do
    state = if match?({:returned, _}, outcome), do: run_rest(state, @most_after), else: state
    Processes.kill_all(state.processes)

    %{
      outcome: outcome,
      choices: Choices.list_deviations(state.shared.choices),
      trace: Enum.reverse(state.trace),
      turns: state.step,
      time: now(state) - @start_time
    }
  end

  defp run_rest(state, 0), do: state

  defp run_rest(state, n) do
    case list_runnable(state) do
      {[], state} -> state
      {[pid | _], state} -> state |> run_turn(pid) |> run_rest(n - 1)
    end
  end

  # Processes that have died since the last turn are noticed here.
  defp list_runnable(state) do
    case Processes.list_runnable(state.processes) do
      {:ok, runnable} -> {runnable, state}
      {:died, pid} -> state |> await_death(pid) |> list_runnable()
    end
  end

  # A message from a process that is not simulated may still arrive.
  defp await_outside(state), do: Processes.await_outside(state.processes)

  defp choose_turn(state, runnable) do
    case choose_kill(state) do
      nil -> choose_process(state, runnable)
      pid -> kill(state, pid)
    end
  end

  defp choose_kill(%{kills: []}), do: nil

  defp choose_kill(%{kills: kills, shared: %{choices: choices}} = state) do
    candidates = Processes.list_labelled(state.processes, kills)
    choice = Choices.choose_rarely(choices, length(candidates) + 1, @kill_odds)
    if choice > 0, do: Enum.at(candidates, choice - 1)
  end

  defp kill(%{kills: kills} = state, pid) do
    label = Processes.process_label(state.processes, pid)
    state = add_step(%{state | kills: kills -- [label]}, pid, :killed)
    Process.exit(pid, :kill)
    await_death(state, pid)
  end

  # The last option is the next timer, if it is due soon: no process is late by seconds.
  defp choose_process(%{shared: %{choices: choices}} = state, runnable) do
    n = length(runnable)
    options = if Timers.due_within?(state.timers, now(state) + @early_ns), do: n + 1, else: n

    choice =
      if options == 1,
        do: 0,
        else: Choices.choose_number(choices, options, &propose(&1, state, runnable))

    if choice == n, do: fire_timer(state), else: run_turn(state, Enum.at(runnable, choice))
  end

  # Half of the seeds prefer some processes for a while, because a uniform choice seldom lets one wait for long.
  defp propose(random, %{shared: %{choices: %{seed: seed}}} = state, runnable) do
    cond do
      rem(random, @early_odds) == 0 -> length(runnable)
      rem(seed, 2) == 0 or rem(random, 8) == 1 -> rem(div(random, 64), length(runnable))
      true -> preferred_index(seed, state, runnable)
    end
  end

  defp preferred_index(seed, %{processes: processes, step: step}, runnable) do
    epoch = div(step, 48)
    rank = &Choices.random_number(seed, {:rank, Processes.process_id(processes, &1), epoch})
    {_pid, index} = runnable |> Enum.with_index() |> Enum.max_by(&rank.(elem(&1, 0)))
    index
  end

  defp now(%{shared: %{time: time}}), do: :atomics.get(time, 1)

  # Any of the timers that are due at the same time may be first.
  defp fire_timer(%{shared: shared} = state) do
    due = Timers.list_next(state.timers, now(state))
    n = length(due)
    choice = if n == 1, do: 0, else: Choices.choose_number(shared.choices, n, &rem(&1, n))
    {at, {ref, pid, message}} = Enum.at(due, choice)
    :atomics.put(shared.time, 1, max(at, now(state)))
    send(pid, message)
    state = %{state | timers: Timers.delete_timer(state.timers, ref)}
    add_step(state, pid, {:timer, message})
  end

  defp run_turn(%{shared: shared} = state, pid) do
    :atomics.add(shared.time, 1, @turn_ns)
    {kind, processes} = Processes.grant_turn(state.processes, pid, shared.ref)
    state = %{state | processes: processes, step: state.step + 1}
    receive_report(state, {pid, kind, System.monotonic_time(:microsecond)})
  end

  # Receives the reports of a process until its turn ends.
  defp receive_report(%{shared: %{ref: ref}} = state, turn) do
    receive do
      {^ref, :rest, pid, handled} ->
        state = %{state | processes: Processes.put_status(state.processes, pid, :rests)}
        state |> add_handled(pid, handled) |> receive_report(:over)

      report when elem(report, 0) == ref ->
        state |> handle_report(report) |> receive_report(turn)

      {:DOWN, _monitor, :process, pid, reason} ->
        state = forget_dead(state, pid, reason)
        receive_report(state, if(match?({^pid, _, _}, turn), do: :over, else: turn))
    after
      wait_ms(turn) -> continue_wait(state, turn)
    end
  end

  # A GenServer reports soon in nearly every turn. Any other process ends its turns in a `receive`.
  defp wait_ms({_pid, :rests, _began}), do: 1
  defp wait_ms(_turn), do: 0

  defp continue_wait(state, :over), do: state

  defp continue_wait(state, {pid, kind, began} = turn) do
    elapsed = System.monotonic_time(:microsecond) - began

    case Processes.suspend_waiting(state.processes, pid, div(elapsed, 1_000)) do
      {:waiting, processes} ->
        add_step(%{state | processes: processes}, pid, {:waits, kind})

      _busy_or_outside when elapsed > @longest_turn_us ->
        %{state | outcome: {:endless, Processes.describe_all(state.processes)}}

      _busy_or_outside ->
        if elapsed < 1_000, do: :erlang.yield(), else: Process.sleep(1)
        receive_report(state, turn)
    end
  end

  defp handle_report(state, {_ref, :spawned, pid, label}),
    do: %{state | processes: Processes.add_process(state.processes, pid, label)}

  defp handle_report(state, {_ref, :starting}),
    do: %{state | processes: Processes.count_starting(state.processes, 1)}

  defp handle_report(state, {_ref, :started, pid, label}) do
    processes = Processes.count_starting(state.processes, -1)
    %{state | processes: Processes.add_process(processes, pid, label)}
  end

  defp handle_report(state, {_ref, :timer, kind, ms, timer}) do
    due = now(state) + ms * 1_000_000
    %{state | timers: Timers.add_timer(state.timers, kind, due, timer)}
  end

  defp handle_report(state, {_ref, :cancel, timer}),
    do: %{state | timers: Timers.delete_timer(state.timers, timer)}

  defp handle_report(state, {_ref, :outcome, outcome}), do: %{state | outcome: outcome}

  defp await_death(state, pid) do
    if Processes.member?(state.processes, pid) do
      receive do
        {:DOWN, _monitor, :process, ^pid, reason} -> forget_dead(state, pid, reason)
      end
    else
      state
    end
  end

  # The end of a process is complete when every other process has its signals.
  defp forget_dead(state, pid, reason) do
    state = state |> add_step(pid, :ended) |> end_client(pid, reason)
    processes = Processes.delete_process(state.processes, pid)
    Processes.await_signals(processes, pid)
    %{state | processes: processes, timers: Timers.delete_process(state.timers, pid)}
  end

  # A process that is linked to it has failed.
  defp end_client(%{client: pid, outcome: nil} = state, pid, reason),
    do: %{state | outcome: {:raised, :exit, reason, []}}

  defp end_client(state, _pid, _reason), do: state

  defp add_handled(state, _pid, nil), do: state
  defp add_handled(state, pid, message), do: add_step(state, pid, {:handled, message})

  defp add_step(%{shared: %{traced?: false}} = state, _pid, _event), do: state

  defp add_step(%{processes: processes} = state, pid, event) do
    deviations = Choices.count_deviations(state.shared.choices)

    step = %{
      process: Processes.process_name(processes, pid),
      event: Trace.describe_event(event, processes.names),
      unusual?: deviations > state.deviations
    }

    %{state | trace: [step | state.trace], deviations: deviations}
  end
end

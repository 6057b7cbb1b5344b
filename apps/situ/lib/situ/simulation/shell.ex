defmodule Situ.Simulation.Shell do
  @moduledoc false
  # The shell of a simulated process: what `Situ.Runtime` does in a simulation. A process starts, or takes one message
  # from its mailbox, when the scheduler grants it a turn, and reports the end of the turn:
  #
  #   scheduler -> process   {ref, :go}
  #   process -> scheduler   {ref, :spawned, pid, label}     a process that waits for its first turn
  #                          {ref, :starting}                announces a process that reports `:started` by itself
  #                          {ref, :started, pid, label}
  #                          {ref, :rest, pid, message}      the end of a turn in which it has handled the message
  #                          {ref, :timer, kind, ms, {timer, pid, message}}, {ref, :cancel, timer}
  #
  # A process that waits in the middle of a turn, for the reply to a call or in another `receive`, is suspended by
  # the scheduler (see Scheduler).
  @behaviour Situ.Runtime
  alias Situ.Runtime
  alias Situ.Simulation.Choices

  @enforce_keys [:ref, :scheduler, :time, :choices, :traced?]
  defstruct [:ref, :scheduler, :time, :choices, :traced?]

  @typedoc "The values that the processes of a simulation share. The cell `time` holds the wall time, ns."
  @type t :: %__MODULE__{
          ref: reference(),
          scheduler: pid(),
          time: :atomics.atomics_ref(),
          choices: Choices.t(),
          traced?: boolean()
        }

  # How long a callback takes, ns: usually nothing; longer than the limit for quick messages, than the interval between
  # flushes, or than a time slice.
  @durations {0, 150_000, 1_500_000, 6_000_000}
  @odds 8

  @impl true
  def spawn_process(%__MODULE__{ref: ref} = simulation, by, label, {call, opts}) do
    spawned = by.spawn_opt(__MODULE__, :run_plain, [simulation, call], opts)
    pid = if is_tuple(spawned), do: elem(spawned, 0), else: spawned
    send(simulation.scheduler, {ref, :spawned, pid, label})
    spawned
  end

  @impl true
  def start_process(%__MODULE__{ref: ref} = simulation, how, label, call) do
    send(simulation.scheduler, {ref, :starting})
    apply(:proc_lib, how, [__MODULE__, :run_started, [simulation, label, call]])
  end

  @doc false
  def run_started(simulation, label, call) do
    send(simulation.scheduler, {simulation.ref, :started, self(), label})
    run_plain(simulation, call)
  end

  @doc false
  def run_plain(simulation, {module, function, args}) do
    Runtime.put_shell({__MODULE__, simulation})
    silence_log()
    await_turn(simulation)
    apply(module, function, args)
  end

  # Thousands of schedules would repeat the same lines.
  if function_exported?(Logger, :put_process_level, 2),
    do: defp(silence_log, do: Logger.put_process_level(self(), :none)),
    else: defp(silence_log, do: Logger.disable(self()))

  defp await_turn(%{ref: ref}) do
    receive do
      {^ref, :go} -> :ok
    end
  end

  @impl true
  def enter_loop(simulation, module, state) do
    [parent | _] = Process.get(:"$ancestors", [nil])
    loop(simulation, module, state, {parent, :started})
  end

  defp loop(%{ref: ref} = simulation, module, state, {parent, handled}) do
    handled = if simulation.traced?, do: handled
    send(simulation.scheduler, {ref, :rest, self(), handled})
    await_turn(simulation)

    receive do
      message -> handle_message(simulation, module, state, {parent, message})
    after
      0 -> loop(simulation, module, state, {parent, :nothing})
    end
  end

  defp handle_message(_simulation, module, state, {parent, {:EXIT, parent, reason}}),
    do: stop(module, reason, state)

  defp handle_message(simulation, module, state, {parent, {:system, from, request}}),
    do: :sys.handle_system_msg(request, from, parent, __MODULE__, [], {simulation, module, state})

  defp handle_message(simulation, module, state, {_parent, message} = turn) do
    case call_module(module, message, state) do
      {:noreply, state} ->
        loop(simulation, module, state, turn)

      {:reply, reply, state} ->
        GenServer.reply(elem(message, 1), reply)
        loop(simulation, module, state, turn)

      {:stop, reason, state} ->
        stop(module, reason, state)

      {:stop, reason, reply, state} ->
        GenServer.reply(elem(message, 1), reply)
        stop(module, reason, state)
    end
  end

  defp call_module(module, message, state) do
    case message do
      {:"$gen_call", from, request} -> module.handle_call(request, from, state)
      {:"$gen_cast", request} -> module.handle_cast(request, state)
      _plain -> module.handle_info(message, state)
    end
  catch
    :throw, result -> result
    :error, reason -> {:stop, {reason, __STACKTRACE__}, state}
    :exit, reason -> {:stop, reason, state}
  end

  defp stop(module, reason, state) do
    module.terminate(reason, state)
    exit(reason)
  end

  @doc false
  def system_continue(parent, _debug, {simulation, module, state}),
    do: loop(simulation, module, state, {parent, :system})

  @doc false
  def system_get_state({_simulation, _module, state}), do: {:ok, state}

  @doc false
  @spec system_terminate(term(), pid(), term(), {t(), module(), term()}) :: no_return()
  def system_terminate(reason, _parent, _debug, {_simulation, module, state}),
    do: stop(module, reason, state)

  @impl true
  def send_after(%__MODULE__{ref: ref} = simulation, message, ms, kind) do
    timer = make_ref()
    send(simulation.scheduler, {ref, :timer, kind, ms, {timer, self(), message}})
    timer
  end

  @impl true
  def cancel_timer(%__MODULE__{ref: ref} = simulation, timer),
    do: send(simulation.scheduler, {ref, :cancel, timer})

  @impl true
  def monotonic_time(%__MODULE__{time: time, choices: choices}) do
    choice = Choices.choose_rarely(choices, tuple_size(@durations), @odds)
    :atomics.add_get(time, 1, elem(@durations, choice))
  end

  @impl true
  def wall_cells(%__MODULE__{time: time}), do: {:simulated, time}

  @impl true
  def choose_number(%__MODULE__{choices: choices}, n),
    do: Choices.choose_rarely(choices, n, @odds)
end

defmodule Situ.Runtime do
  @moduledoc false
  # The only way in which the runtime starts processes, enters their loops, sets timers and reads the time. In
  # production these are functions of the VM. A process of a simulation (`Situ.Simulation`) has another module with the
  # same functions in its dictionary, and the processes that it starts inherit it.
  # See docs/adr/0156-a-simulation-replaces-the-process-shell.md.
  @key :situ_runtime

  @typedoc "A module with this behaviour, and its first argument."
  @type shell :: {module(), term()}

  @callback spawn_process(term(), :proc_lib | :erlang, String.t(), {mfa_args(), [term()]}) ::
              pid() | {pid(), reference()}
  @callback start_process(term(), :start | :start_link, String.t(), mfa_args()) :: term()
  @callback enter_loop(term(), module(), state :: term()) :: no_return()
  @callback send_after(term(), term(), non_neg_integer(), :wait | :background) :: reference()
  @callback cancel_timer(term(), reference()) :: term()
  @callback monotonic_time(term()) :: integer()
  @callback wall_cells(term()) :: term()
  @callback choose_number(term(), pos_integer()) :: non_neg_integer()

  @type mfa_args :: {module(), atom(), [term()]}

  @doc "Returns the module that replaces the VM's functions in this process, or `nil`."
  @spec fetch_shell() :: shell() | nil
  def fetch_shell, do: Process.get(@key)

  @doc "Puts the calling process into a simulation."
  @spec put_shell(shell()) :: term()
  def put_shell(shell), do: Process.put(@key, shell)

  @doc "Returns whether the calling process belongs to a simulation."
  @spec simulated?() :: boolean()
  def simulated?, do: fetch_shell() != nil

  @doc "Spawns a process with `spawn_opt/4` of `:proc_lib` or `:erlang`; `label` names it in a simulation."
  @spec spawn_process(:proc_lib | :erlang, String.t(), mfa_args(), [term()]) ::
          pid() | {pid(), reference()}
  def spawn_process(by, label, {module, function, args} = call, opts) do
    case fetch_shell() do
      nil -> by.spawn_opt(module, function, args, opts)
      {shell, simulation} -> shell.spawn_process(simulation, by, label, {call, opts})
    end
  end

  @doc "Starts a process that acknowledges its start with `:proc_lib.init_ack/1`."
  @spec start_process(:start | :start_link, String.t(), mfa_args()) :: term()
  def start_process(how, label, {module, function, args} = call) do
    case fetch_shell() do
      nil -> apply(:proc_lib, how, [module, function, args])
      {shell, simulation} -> shell.start_process(simulation, how, label, call)
    end
  end

  @doc "Makes the calling process a GenServer with this callback module and state."
  @spec enter_loop(module(), term()) :: no_return()
  def enter_loop(module, state) do
    case fetch_shell() do
      nil -> :gen_server.enter_loop(module, [], state)
      {shell, simulation} -> shell.enter_loop(simulation, module, state)
    end
  end

  @doc "Returns the module in which a GenServer waits for messages."
  @spec loop_module() :: module()
  def loop_module do
    case fetch_shell() do
      nil -> :gen_server
      {shell, _simulation} -> shell
    end
  end

  @doc """
  Sends a message to the calling process after `ms`. A `:background` timer only observes: a pipeline in which nothing
  else is to happen is deadlocked.
  """
  @spec send_after(term(), non_neg_integer(), :wait | :background) :: reference()
  def send_after(message, ms, kind \\ :wait) do
    case fetch_shell() do
      nil -> Process.send_after(self(), message, ms)
      {shell, simulation} -> shell.send_after(simulation, message, ms, kind)
    end
  end

  @doc "Cancels a timer of the calling process."
  @spec cancel_timer(reference()) :: term()
  def cancel_timer(timer) do
    case fetch_shell() do
      nil -> Process.cancel_timer(timer)
      {shell, simulation} -> shell.cancel_timer(simulation, timer)
    end
  end

  @doc "Returns the monotonic time, ns."
  @spec monotonic_time() :: integer()
  def monotonic_time do
    case fetch_shell() do
      nil -> :erlang.monotonic_time(:nanosecond)
      {shell, simulation} -> shell.monotonic_time(simulation)
    end
  end

  @doc "Returns the cells of the simulation's wall time, or `nil` in production."
  @spec wall_cells() :: term()
  def wall_cells do
    case fetch_shell() do
      nil -> nil
      {shell, simulation} -> shell.wall_cells(simulation)
    end
  end

  @doc "Returns a number below `n` that the schedule of a simulation has chosen; 0 in production."
  @spec choose_number(pos_integer()) :: non_neg_integer()
  def choose_number(n) do
    case fetch_shell() do
      nil -> 0
      {shell, simulation} -> shell.choose_number(simulation, n)
    end
  end
end
